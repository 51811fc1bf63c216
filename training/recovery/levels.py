"""The targets and cameras of a run at several sizes, for stages that begin with small images."""

from typing import NamedTuple

from torch import Tensor, nn

from torch_radbp.photographs.area_average import area_average
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.sensor.kind import ProjectiveCamera
from torch_radbp.training.recovery.recovered import RecoveredParameter
from torch_radbp.training.recovery.targets import Targets


class Level(NamedTuple):
    """One size.

    Attributes:
        cameras: by the names that they have in the scene.
        images: (B, 3, H, W), linear RGB.
        masks: (B, 1, H, W) in [0, 1]; None: all pixels count the same.
    """

    cameras: dict[str, nn.Module]
    images: Tensor
    masks: Tensor | None


class Levels:
    """All sizes of a run. Pixels are averages of light; cameras share all parameters with those of the scene.

    Args:
        scene: with its parametrisations.
        targets: of the run, as they were read.
        scales: the sizes, relative to that of the targets.
        parameters: that are recovered.

    Raises:
        ValueError: a size at which pixels would not be square, a sensor that cannot be resized, or of which parameters in
            pixels are recovered.
    """

    def __init__(self, scene: Scene, targets: Targets, scales: list[float], parameters: list[RecoveredParameter]):
        self.scene, self.scale = scene, 1.0
        cameras = {name: scene.named_sensors[name] for name in targets.names}
        self.levels = {1.0: Level(cameras, targets.images, targets.masks)}
        for scale in scales:
            if scale != 1:
                self.levels[scale] = self.smaller(scale, parameters)

    def smaller(self, scale: float, parameters: list[RecoveredParameter]) -> Level:
        """The level of a scale below 1."""
        cameras, images, masks = self.levels[1.0]
        width, height = (max(1, round(side * scale)) for side in (images.shape[3], images.shape[2]))
        for name, camera in cameras.items():
            if not isinstance(camera, ProjectiveCamera) or getattr(self.scene, name, None) is not camera:
                raise ValueError(f"stages: scale = {scale:g} needs cameras that stand in the scene by themselves, and "
                                 f"{name!r} does not; leave the scale out")
            in_pixels = [each.name for each in parameters if each.module is camera and each.attribute in camera.in_pixels]
            if in_pixels:
                raise ValueError(f"stages: scale = {scale:g} changes the size of pixels, in which {', '.join(in_pixels)} "
                                 f"{'is' if len(in_pixels) == 1 else 'are'} recovered; leave the scale out")
        try:
            resized = {name: camera.resized(width, height) for name, camera in cameras.items()}
        except ValueError as error:
            raise ValueError(f"stages: scale = {scale:g}: {error}") from None
        return Level(resized, area_average(images, width, height),
                     None if masks is None else area_average(masks, width, height))

    def place(self, scale: float) -> Level:
        """Puts the cameras of a scale into the scene, and returns the level."""
        level = self.levels[scale]
        if scale != self.scale:
            for name, camera in level.cameras.items():
                setattr(self.scene, name, camera)
            self.scale = scale
        return level
