"""`python -m legid.cli`: the command line where no `legid` is on the path."""

import sys

from legid.cli.main import main

sys.exit(main())
