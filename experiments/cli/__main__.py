"""`python -m experiments.cli`: the command line where no `legid` is on the path."""

import sys

from experiments.cli.main import main

sys.exit(main())
