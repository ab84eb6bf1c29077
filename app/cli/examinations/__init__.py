"""What `gridpose doctor` looks at, a module each; none of them changes anything."""
