"""Finds out, in a child process, whether OpenGL draws here: a broken driver may abort the interpreter that asks.

The answer is kept in the environment variable GFP_GRASP_GL (egl, osmesa, glfw, cgl or none), so that worker processes
inherit it and a user may set it to skip the question.
"""

import os
import platform
import subprocess
import sys

ENVIRONMENT_VARIABLE = "GFP_GRASP_GL"
LONGEST_PROBE_S = 30.0

# One box, 0.9 m below the camera: only a driver that gives this depth is believed.
_PROBE = """
import importlib, sys
import mujoco, numpy as np
model = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><geom type="box" size=".2 .2 .1"/></worldbody></mujoco>')
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
from gfp_grasp.camera.render import OpenGLDepth
from gfp_grasp.camera.pinhole import intrinsics
from gfp_grasp.transforms import look_at
depth, _ = OpenGLDepth(model, sys.argv[1]).draw(
    model, data, K=intrinsics(32, 32, 10.0), width=32, height=32, T_world_camera=look_at((0, 0, 1), (0, 0, 0)))
sys.stdout.write('works' if abs(depth - 0.9).max() < 1e-5 else 'wrong')
sys.stdout.flush()
import os
os._exit(0)
"""


def opengl_backend() -> str:
    """Name of the OpenGL platform that draws depth in this place, or "none"."""
    known = os.environ.get(ENVIRONMENT_VARIABLE)
    if known is None:
        known = next((name for name in _candidates() if _works(name)), "none")
        os.environ[ENVIRONMENT_VARIABLE] = known
    return known


def _candidates() -> tuple[str, ...]:
    asked = os.environ.get("MUJOCO_GL", "").lower().strip()
    if asked in ("disable", "disabled", "off", "false", "0"):
        return ()
    if asked in ("egl", "osmesa", "glfw", "cgl"):
        return (asked,)
    return {"Linux": ("egl", "osmesa"), "Darwin": ("cgl",)}.get(platform.system(), ("glfw",))


def _works(name: str) -> bool:
    environment = {**os.environ, "MUJOCO_GL": name, ENVIRONMENT_VARIABLE: name}
    environment["PYTHONPATH"] = os.pathsep.join([path for path in sys.path if path])
    try:
        answer = subprocess.run(
            [sys.executable, "-c", _PROBE, name],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=LONGEST_PROBE_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return answer.returncode == 0 and answer.stdout.endswith(b"works")
