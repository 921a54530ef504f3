"""`python -m rotorjax`: the command line."""

import sys

from rotorjax.cli import main

if __name__ == "__main__":
    sys.exit(main())
