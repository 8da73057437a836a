"""What every room of the daemon uses: errors with advice, files written whole, progress."""
