"""Independent jobs over processes of this machine or of a cluster, with the same answer wherever they run."""

from gfp_grasp.parallel.jobs import pmap
from gfp_grasp.parallel.lost import ATTEMPTS
from gfp_grasp.parallel.threads import one_thread

__all__ = ["ATTEMPTS", "one_thread", "pmap"]
