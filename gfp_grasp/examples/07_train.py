"""7. Train a network: here a few steps of the registration network on a few shapes, to see that it runs.

`python -m gfp_grasp.examples.07_train [STEPS]`; without --steps, --limit and --views the command trains as the shipped
weights were trained. A run that was stopped goes on from the last checkpoint in --runs.
"""

import sys

from gfp_grasp.cli import main

if __name__ == "__main__":
    steps = sys.argv[1] if len(sys.argv) > 1 else "20"
    small = ["--steps", steps, "--limit", "4", "--views", "1"]
    main(["train", "pcrnet", *small, "--runs", "runs", "--file", "pcrnet.safetensors"])
