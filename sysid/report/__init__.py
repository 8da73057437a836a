"""The identification report: figures and page."""
