"""Every refusal of the package, by name. Each message says what came, what was expected and what to do."""


class GfpGraspError(Exception):
    """Base of every error that the package raises on purpose."""


class InvalidCloud(GfpGraspError, ValueError):
    """The cloud has the wrong shape or type, is degenerate, or cannot be in metres."""


class TooFewPoints(InvalidCloud):
    """Fewer finite points than the method needs."""


class InvalidView(GfpGraspError, ValueError):
    """Depth picture, intrinsics, pose or mask do not fit each other."""


class NothingDetected(GfpGraspError):
    """No object stands out from the support plane."""


class UnknownCategory(GfpGraspError, ValueError):
    """A category, shape family or primitive that is not among those on offer."""


class FitDiverged(GfpGraspError):
    """No start of the registration reached a plausible fit."""


class TrainingDiverged(GfpGraspError):
    """The loss of a training, or its gradient, is no finite number any more."""


class NoSurface(GfpGraspError):
    """A network that completes finds nothing solid around the points."""


class InvalidMesh(GfpGraspError, ValueError):
    """A mesh is empty, flat, not finite, badly indexed or not closed where it must be."""


class UnreadableFile(GfpGraspError, ValueError):
    """A file that cannot be read as what it should be."""


class DecompositionFailed(GfpGraspError):
    """Convex decomposition crashed, ran out of time or gave nothing usable, and no retry helped."""


class Cancelled(GfpGraspError):
    """A job that its caller called off before it was done."""


class InvalidOption(GfpGraspError, ValueError):
    """An option or configuration value outside of what is legal; the message lists what is legal."""


class UnknownCompleter(InvalidOption):
    """A completer's name that is neither built in nor importable."""


class UnknownDetector(InvalidOption):
    """A detector's name that is neither built in nor importable."""


class InvalidAction(GfpGraspError, ValueError):
    """An action that is not a finite vector of the action space."""


class InvalidGrasp(GfpGraspError, ValueError):
    """A grasp whose pose is no finite (4, 4) matrix, or whose width is no width."""


class InvalidScene(GfpGraspError, ValueError):
    """A scene that MuJoCo does not compile; the message names the part."""


class AssetMissing(GfpGraspError, FileNotFoundError):
    """A data file that ships with the package is not where it should be."""


class NotTrained(AssetMissing):
    """A network whose weights do not ship with the package; the message has the command that trains it."""


class BuildFailed(GfpGraspError):
    """A primitive cannot be built from the meshes that were given."""


class WorkerLost(GfpGraspError):
    """A process died under a job, again and again."""


class CannotWrite(GfpGraspError, OSError):
    """A file of results cannot be written: no room, no right, or no such place."""
