"""A batch of sensors of one size."""

from __future__ import annotations

from torch_radbp.film.hdrfilm import HDRFilm
from torch_radbp.plugin import Film, Sampler, Sensor, register
from torch_radbp.sensor.sampler import LowDiscrepancy


@register("sensor", "batch")
class Batch(Sensor):
    """Sensors that are rendered together, by the film and the sampler of this one instead of their own.

    As in Mitsuba the width of the film is divided among them. Mitsuba puts their images side by side; here each is an image
    of its own, as sensors of a scene always are: `torch.cat(list(image), -1)` of (B, 3, H, W / B) is Mitsuba's image, but
    for the reconstruction filter, which does not mix neighbours here. They are called `batch.sensor0`, `batch.sensor1`,
    ..., or by their ids, where `batch` is the name of this one.

    Args:
        sensors: one or more, of any kind but this.
        film: of all images side by side: its width is divided among the sensors.
        sampler: the random numbers; an `ldsampler` by default.
        shutter_open, shutter_close: accepted, but without effect on cameras without motion.

    Raises:
        ValueError: if there is none, or the width cannot be divided by their number, or the film has a crop window.
    """

    def __init__(self, *, sensors: list[Sensor], shutter_open: float = 0.0, shutter_close: float = 0.0,
                 film: Film | None = None, sampler: Sampler | None = None):
        super().__init__()
        self.film = HDRFilm() if film is None else film
        self.sampler = LowDiscrepancy() if sampler is None else sampler
        self.shutter_open, self.shutter_close = shutter_open, shutter_close
        width, height, count = self.film.width, self.film.height, len(sensors)
        if any(isinstance(sensor, Batch) for sensor in sensors):
            raise ValueError("a batch takes sensors, not another batch")
        if (self.film.crop_width, self.film.crop_height) != (width, height):
            raise ValueError(f"the film of a batch must have no crop window, got {self.film.crop_width} x "
                             f"{self.film.crop_height} of {width} x {height}; render its sensors one by one")
        if width % count:
            raise ValueError(f"the width of the film of a batch must be a multiple of its {count} sensors, got {width}")
        self.names: tuple[str, ...] = ()
        for number, sensor in enumerate(sensors):
            name = (sensor.id or f"sensor{number}").replace(".", "_")
            if hasattr(self, name):
                raise ValueError(f"a sensor of a batch cannot be called {name!r}; use another id")
            sensor.sampler = self.sampler
            sensor.film = HDRFilm(width=width // count, height=height, sample_border=self.film.sample_border,
                                  pixel_format=self.film.pixel_format, rfilter=self.film.rfilter)
            self.add_module(name, sensor)
            self.names = (*self.names, name)

    @property
    def sensors(self) -> list[Sensor]:
        """The sensors of the batch."""
        return [getattr(self, name) for name in self.names]

    def views(self) -> dict[str, Sensor]:
        return {f".{name}": sensor for name, sensor in zip(self.names, self.sensors)}
