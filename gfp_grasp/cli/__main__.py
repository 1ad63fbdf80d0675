"""`python -m gfp_grasp.cli` is `gfp-grasp`."""

from gfp_grasp.cli import main

if __name__ == "__main__":
    main()
