"""Programs that show how the package is used; each runs as `python -m gfp_grasp.examples.NAME`."""
