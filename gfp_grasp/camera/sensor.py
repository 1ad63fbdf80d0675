"""What a depth sensor does to an ideal picture: noise, lost returns, flying pixels, steps."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy import ndimage
from scipy.special import ndtri

from gfp_grasp.camera.pinhole import camera_points, surface_normals
from gfp_grasp.errors import InvalidOption
from gfp_grasp.types import DepthImage


@dataclass(frozen=True)
class SensorModel:
    """Noise of a depth sensor. Every default is "no effect": SensorModel() is the ideal sensor.

    The standard deviation of the depth of a pixel at depth z, seen at angle t to its surface's normal, is
    `sigma_m + sigma_per_m2 * z^2 + sigma_grazing_m * (t / (pi/2 - t))^2`; the last term is Nguyen, Izadi and Lovell
    2012 ("Modeling Kinect sensor noise"), the middle one the triangulation error of every stereo or structured light.

    Attributes:
        sigma_m: Depth noise at any depth, m.
        sigma_per_m2: Its growth with depth squared, m per m^2.
        sigma_grazing_m: Its growth with the angle of incidence, m (reached at 45 degrees).
        correlation_px: Width of the matching window that neighbouring pixels share, px (one standard deviation);
            0 draws every pixel by itself.
        lost_angle_deg: Angle of incidence at which half of the returns are lost; 90 loses none.
        lost_angle_soft_deg: Width of that transition, degrees.
        hole_share: Share of the pixels that lie in blobs without return.
        hole_radius_px: Radius of those blobs, px.
        edge_m: A step in depth between neighbours that makes a silhouette, m.
        flying_share: Share of the pixels on silhouettes that come back between the near and the far surface.
        edge_lost_share: Share of the pixels on silhouettes that are lost.
        step_m: Depth is rounded to multiples of this, m; 0 leaves it.
        nearest_m: Nothing nearer comes back, m.
        farthest_m: Nothing farther comes back, m.
    """

    sigma_m: float = 0.0
    sigma_per_m2: float = 0.0
    sigma_grazing_m: float = 0.0
    correlation_px: float = 0.0
    lost_angle_deg: float = 90.0
    lost_angle_soft_deg: float = 3.0
    hole_share: float = 0.0
    hole_radius_px: float = 4.0
    edge_m: float = 0.01
    flying_share: float = 0.0
    edge_lost_share: float = 0.0
    step_m: float = 0.0
    nearest_m: float = 0.0
    farthest_m: float = float("inf")

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not value >= 0:
                raise InvalidOption(f"{field.name} is {value}; a number >= 0 is expected")
        for name in ("hole_share", "flying_share", "edge_lost_share"):
            if getattr(self, name) > 1:
                raise InvalidOption(f"{name} is {getattr(self, name)}; a share between 0 and 1 is expected")
        if self.flying_share + self.edge_lost_share > 1:
            raise InvalidOption("flying_share and edge_lost_share add up to more than 1: they share the same pixels")
        if not self.lost_angle_deg <= 90 or not self.lost_angle_soft_deg > 0 or not self.edge_m > 0:
            raise InvalidOption("lost_angle_deg <= 90, lost_angle_soft_deg > 0 and edge_m > 0 are expected")
        if not self.nearest_m < self.farthest_m:
            raise InvalidOption(f"the range {self.nearest_m} to {self.farthest_m} m is empty")

    @classmethod
    def ideal(cls) -> SensorModel:
        """Changes nothing."""
        return cls()

    @classmethod
    def gaussian(cls, sigma_m: float) -> SensorModel:
        """Independent noise of one standard deviation on every pixel, m, and nothing else."""
        return cls(sigma_m=sigma_m)

    @classmethod
    def realsense(cls) -> SensorModel:
        """An active stereo camera at desk range: 1 to 3 mm at 0.6 m, torn silhouettes, 1 mm steps."""
        return cls(
            sigma_m=0.0004,
            sigma_per_m2=0.0022,
            sigma_grazing_m=0.0006,
            correlation_px=1.2,
            lost_angle_deg=82.0,
            hole_share=0.005,
            hole_radius_px=3.0,
            flying_share=0.25,
            edge_lost_share=0.25,
            step_m=0.001,
            nearest_m=0.2,
            farthest_m=3.0,
        )

    @classmethod
    def kinect(cls) -> SensorModel:
        """Structured light, coarser: about 2 mm at 0.8 m, shadows and holes, 2 mm steps."""
        return cls(
            sigma_m=0.0008,
            sigma_per_m2=0.0019,
            sigma_grazing_m=0.0005,
            correlation_px=1.0,
            lost_angle_deg=78.0,
            hole_share=0.01,
            hole_radius_px=5.0,
            flying_share=0.1,
            edge_lost_share=0.4,
            step_m=0.002,
            nearest_m=0.4,
            farthest_m=4.0,
        )


def apply_sensor(image: DepthImage, model: SensorModel, rng: np.random.Generator) -> DepthImage:
    """The same view as the sensor would give it.

    Args:
        image: Ideal depth picture.
        model: What the sensor does; SensorModel.ideal() returns an equal picture.
        rng: Source of chance; the same state gives the same picture.

    Returns:
        A new picture with the same K and pose.
    """
    ideal = image.depth_m.astype(np.float64)
    depth = np.where((ideal >= model.nearest_m) & (ideal <= model.farthest_m), ideal, 0.0)
    angle = _incidence(image, model.edge_m) if model.sigma_grazing_m or model.lost_angle_deg < 90 else None
    torn, lost_at_edges = _torn_silhouettes(ideal, model, rng)
    depth = np.where((depth > 0) & (torn > 0), torn, depth)
    lost = lost_at_edges | _lost_by_angle(angle, model, rng) | _holes(ideal.shape, model, rng)
    noisy = depth + _sigma(depth, angle, model) * _unit_noise(ideal.shape, model.correlation_px, rng)
    if model.step_m:
        noisy = np.round(noisy / model.step_m) * model.step_m
    return DepthImage(np.where((depth > 0) & ~lost, noisy, 0.0), image.K, image.T_world_camera)


def _incidence(image: DepthImage, edge_m: float) -> np.ndarray:
    """Angle (h, w) rad between the ray and the surface's normal; 0 where the normal is not known."""
    points, normals = camera_points(image), surface_normals(image, max_jump_m=edge_m)
    rays = points / np.linalg.norm(points, axis=-1, keepdims=True)
    cosine = -np.einsum("hwc,hwc->hw", rays, normals)
    return np.where(np.isfinite(cosine), np.arccos(np.clip(cosine, 0.0, 1.0)), 0.0)


def _sigma(depth: np.ndarray, angle: np.ndarray | None, model: SensorModel) -> np.ndarray:
    sigma = model.sigma_m + model.sigma_per_m2 * depth**2
    if angle is not None:
        steep = np.minimum(angle, np.radians(85.0))  # the formula has no bound at 90 degrees
        sigma = sigma + model.sigma_grazing_m * (steep / (np.pi / 2 - steep)) ** 2
    return sigma


def _unit_noise(shape: tuple[int, ...], correlation_px: float, rng: np.random.Generator) -> np.ndarray:
    """Gaussian noise of unit variance; smoothing it would shrink it by the kernel's 2-norm, which is divided out."""
    noise = rng.standard_normal(shape)
    if not correlation_px:
        return noise
    impulse = np.zeros(2 * int(np.ceil(4 * correlation_px)) + 1)
    impulse[len(impulse) // 2] = 1.0
    kernel = ndimage.gaussian_filter1d(impulse, correlation_px, mode="constant")
    return ndimage.gaussian_filter(noise, correlation_px, mode="wrap") / (kernel @ kernel)


def _lost_by_angle(angle: np.ndarray | None, model: SensorModel, rng: np.random.Generator) -> np.ndarray | bool:
    if angle is None or model.lost_angle_deg >= 90:
        return False
    excess = (np.degrees(angle) - model.lost_angle_deg) / model.lost_angle_soft_deg
    return rng.random(angle.shape) < 1 / (1 + np.exp(np.clip(-4 * excess, -50, 50)))


def _holes(shape: tuple[int, ...], model: SensorModel, rng: np.random.Generator) -> np.ndarray | bool:
    """Blobs (h, w) bool: smoothed noise above the quantile that makes their share right on average."""
    if not model.hole_share:
        return False
    smooth = _unit_noise(shape, max(model.hole_radius_px, 0.1), rng)
    return smooth > ndtri(1 - model.hole_share)


def _torn_silhouettes(
    depth: np.ndarray, model: SensorModel, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray | bool]:
    """Depth (h, w) m of the flying pixels, 0 elsewhere, and the pixels (h, w) bool that silhouettes lose."""
    if not model.flying_share and not model.edge_lost_share:
        return np.zeros_like(depth), False
    near = ndimage.minimum_filter(np.where(depth > 0, depth, np.inf), size=3, mode="nearest")
    far = ndimage.maximum_filter(depth, size=3, mode="nearest")
    silhouette = (depth > 0) & (far - near > model.edge_m) & ~_is_slope(depth, model.edge_m)
    chance, mixture = rng.random(depth.shape), rng.random(depth.shape)
    flying = silhouette & (chance < model.flying_share)
    lost = silhouette & (chance > 1 - model.edge_lost_share)
    return np.where(flying, near + mixture * (np.where(flying, far, 0.0) - np.where(flying, near, 0.0)), 0.0), lost


def _is_slope(depth: np.ndarray, edge_m: float) -> np.ndarray:
    """(h, w) bool: one steep but even surface: the inverse depth of a plane is linear in the pixels."""
    inverse = np.divide(1.0, depth, out=np.full_like(depth, np.nan), where=depth > 0)
    bend = np.maximum(_bend(inverse, 0), _bend(inverse, 1)) * depth**2
    return bend < edge_m / 2


def _bend(values: np.ndarray, axis: int) -> np.ndarray:
    """(h, w) size of the second difference; 0 at the picture's border, where there is none."""
    bend = np.zeros_like(values)
    inner = np.moveaxis(bend, axis, 0)[1:-1]
    inner[:] = np.moveaxis(np.abs(np.diff(values, n=2, axis=axis)), axis, 0)
    return bend
