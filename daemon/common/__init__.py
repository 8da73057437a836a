"""What every room of the daemon uses: errors with hints, files written whole, progress."""
