"""What an analysis returns: JSON documents and plots of a session's estimates."""
