"""The scenes of the tests. What most tests need is imported from here, the rest from its module.

A scene that only one test has stands in that test; what two of them need is here:

* the words: `description` (colours, cameras, rectangles, loading), `parts`, `endless`, `quadrilateral`, `meshes`,
  `mesh_attributes`, `materials`, `distant_lamps`, `networks`;
* every plugin: `every_plugin` and `lights` (one scene for each), `everything` (all of them in four scenes), `extremes` (ends
  of ranges), `quiet` (with little noise), `pairs` (which parameter is examined where), `one_of_each`, `aovs`;
* what moves: `moving`, `shadows`, `mirrors`, `cut_outs`, `inner_jumps`, `crossings`, `contacts`, `projected`, `rough`,
  `projective_setups`;
* small rooms: `cases`; without noise: `sunlit`; media: `media`, `phase_functions`;
* what is compared with Mitsuba, as XML: `xml`.
"""

from tests.scenes.cases import CASES, Case, cornell, furnace, sky_and_points, textured, textured_lamp, two_sided
from tests.scenes.description import GLOW, SKY, diffuse, load, look_at, overhead, parameters, rectangle, rgb, sensor, texels

__all__ = ["CASES", "GLOW", "SKY", "Case", "cornell", "diffuse", "furnace", "load", "look_at", "overhead", "parameters",
           "rectangle", "rgb", "sensor", "sky_and_points", "texels", "textured", "textured_lamp", "two_sided"]
