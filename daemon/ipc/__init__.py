"""What travels between the processes of a run: records on pipes, requests, signals."""
