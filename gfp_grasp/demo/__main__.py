"""`python -m gfp_grasp.demo` is `gfp-grasp demo`."""

import sys

from gfp_grasp.cli import main

if __name__ == "__main__":
    main(["demo", *sys.argv[1:]])
