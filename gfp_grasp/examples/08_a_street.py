"""8. A street: one LiDAR scan goes in, whole vehicles come out, as one scene for MuJoCo.

`python -m gfp_grasp.examples.08_a_street [SEED]`; it simulates a street and scans it once.
"""

import sys

import numpy as np

from gfp_grasp import complete_scene
from gfp_grasp.completion import CompletedScene
from gfp_grasp.scenes import check_file, draw_street, scan_street

VEHICLES = ("car", "van", "truck", "bus")  # what stands on four wheels: a bicycle falls over without a rider's balance

if __name__ == "__main__":
    rng = np.random.default_rng(int(sys.argv[1]) if len(sys.argv) > 1 else 4)
    street = draw_street(rng, num_things=10, split="test")
    scan, _ = scan_street(street, rng)  # a RangeImage; gfp_grasp.camera.range_image makes one of your own points

    # complete_scene(scan, detector=GivenBoxes(boxes)) of gfp_grasp.detect completes what is in boxes of your own.
    scene = complete_scene(scan)
    vehicles = CompletedScene.of([one for one in scene if one.category in VEHICLES], scan)
    print(f"{len(street.things)} things in the street, {len(scene)} found, {len(vehicles)} of them vehicles")
    for name, vehicle in zip(vehicles.names, vehicles, strict=True):
        away_m = np.linalg.norm(vehicle.mesh.bounds.mean(axis=0) - scan.viewpoint)
        size = " x ".join(f"{extent:.1f}" for extent in vehicle.detection.box.extents)
        print(f"{name}: {away_m:.0f} m away, seen {size} m, {1 - vehicle.observed.mean():.0%} of it is guessed")

    print(f"wrote {vehicles.export('street.glb')}")
    path = vehicles.export("street.xml")  # MJCF: each vehicle is free to move and stands on the road below it
    checks = check_file(path)  # loads it in MuJoCo and simulates two seconds
    print(f"{sum(check.stands for check in checks)} of {len(checks)} vehicles stand still in {path}")
