"""4. Plan grasps on what one view showed, and try the best one on the true object.

`python -m gfp_grasp.examples.04_plan_and_try_a_grasp [SEED]`
"""

import sys

from gfp_grasp import plan_grasps
from gfp_grasp.envs import GfpGraspEnv

if __name__ == "__main__":
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 0
    env = GfpGraspEnv(completer="gfpnet", limit=6)  # or gymnasium.make("gfp_grasp:GfpGrasp-v0", ...)
    observation, info = env.reset(seed=seed)  # draws an object, looks at it once, and completes it
    print(f"{info['object']}, {1000 * info['mass_kg']:.0f} g, {info['num_observed']} points seen")

    if env.completion is None:
        sys.exit(info["completion_error"])
    grasps = plan_grasps(env.completion, num=8, seed=seed)  # on the completion: the planner does not know the truth
    for rank, grasp in enumerate(grasps):
        position = grasp.T_world_gripper[:3, 3].round(3)
        print(f"grasp {rank}: quality {grasp.quality:.2f}, opening {1000 * grasp.width_m:.0f} mm, at {position} m")
    if grasps:
        action = env.action_code.encode(grasps[0])
        _, reward, _, _, info = env.step(action)  # approach, close, lift, shake, let go
        print(f"reward {reward:.0f}: {info['reason']}, lifted by {1000 * info['lift_m']:.0f} mm")
