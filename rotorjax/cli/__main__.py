"""`python -m rotorjax.cli`."""

import sys

from rotorjax.cli import main

sys.exit(main())
