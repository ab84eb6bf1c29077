"""Cameras and poses of a session: which images are used, the lens, the board's symmetry, and each image's pose."""

from core.session.estimation.agreement import worst_poses
from core.session.estimation.image_selection import select_images
from core.session.estimation.lens_model import observed_radius
from core.session.estimation.poses_by_image import ImagePose, image_poses
from core.session.estimation.session_estimate import estimate_session
from core.session.estimation.target_refinement import RefinedTarget, refine_target, target_transforms

__all__ = [
    "ImagePose",
    "RefinedTarget",
    "estimate_session",
    "image_poses",
    "observed_radius",
    "refine_target",
    "select_images",
    "target_transforms",
    "worst_poses",
]
