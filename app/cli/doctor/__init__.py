"""`gridpose doctor`: prints the checks of the installation."""
