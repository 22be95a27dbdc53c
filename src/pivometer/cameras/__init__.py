"""The camera model, its distortion, and rigs of cameras."""

from pivometer.cameras.model import Camera
from pivometer.cameras.rig import Rig

__all__ = ["Camera", "Rig"]
