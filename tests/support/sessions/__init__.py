"""Sessions whose grid points, readings and commands are known: stored without workers, asked for over HTTP."""
