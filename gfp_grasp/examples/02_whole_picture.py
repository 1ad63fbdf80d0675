"""2. Complete a whole depth picture: every object on the table, each with its class and its time.

`python -m gfp_grasp.examples.02_whole_picture [FILE.npz]`; without a file it takes the sample that ships.
"""

import sys

from gfp_grasp import complete_scene
from gfp_grasp.captures import read_capture

if __name__ == "__main__":
    capture = read_capture(sys.argv[1] if len(sys.argv) > 1 else "sample")
    assert capture.view is not None, "a picture is needed, not a cloud alone"
    # complete_scene(detector=) takes the name of another detector; package.module:function names one of your own.
    for number, completion in enumerate(complete_scene(capture.view, up=capture.up)):
        seconds = sum(completion.timings_s.values())
        print(
            f"object {number}: {completion.category} at {completion.T_world_object[:3, 3].round(3)} m, {seconds:.2f} s"
        )
        print(f"wrote {completion.export(f'object_{number}.ply')}")
