"""`python -m steerd`: the command line."""

from steerd.daemon.cli.main import main

if __name__ == "__main__":
    main()
