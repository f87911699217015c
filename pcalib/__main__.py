"""`python -m pcalib` is the command `pcalib`."""

import sys

from pcalib.cli import main

if __name__ == "__main__":
    sys.exit(main())
