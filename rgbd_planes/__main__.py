"""``python -m rgbd_planes``: the command line."""

import sys

from rgbd_planes.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
