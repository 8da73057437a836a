"""`python -m steerd`: the command line."""

import sys

from steerd.daemon.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
