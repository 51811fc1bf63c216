"""AOV images with all parts of their derivatives: of the interior, and boundary terms."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.aov.images import channels_of, lane_values, render_aovs
from torch_radbp.aov.quantity import OF_PATHS, QUANTITIES, TURNING, UNDIFFERENTIATED, alpha_of_surroundings, plain
from torch_radbp.boundary.curve.outline import Jumps
from torch_radbp.boundary.terms.of_call import EdgesOfCall
from torch_radbp.boundary.terms.primary import SeenByCamera, jumps_of_views
from torch_radbp.call.render_call import RenderCall
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.step import Onward
from torch_radbp.rendering.settings import INTERIOR
from torch_radbp.tensors.differentiated import primal


def named_quantities(renderer, call: RenderCall, edges: EdgesOfCall, outputs: dict[str, str],
                     channels: Tensor | None = None) -> dict[str, Tensor]:
    """Renders AOV images by name, with all terms of their derivatives. `call`, `channels`: as for `render_aovs`; `edges`: of
    the call; `outputs`: the quantities by name."""
    names = tuple(dict.fromkeys(outputs.values()))
    if call.scene.layout.surround is not None and not renderer.hide_emitters:
        renderer.jump_watch.say(alpha_of_surroundings(names))
    images = render_aovs(call, names, channels)
    images = images if INTERIOR in renderer.terms else {name: primal(image) for name, image in images.items()}
    if edges.in_view is not None:
        images |= {name: images[name] + jump for name, jump in aov_jumps(call, edges.in_view, names).items()}
    return {output: images[quantity] for output, quantity in outputs.items()}


def aov_jumps(call: RenderCall, jumps: list[Jumps], names: tuple[str, ...]) -> dict[str, Tensor]:
    """Boundary terms of AOV images, by name: zeros whose derivative is what edges of surfaces contribute.

    Args:
        call: in which shapes or cameras are differentiated.
        jumps: the edges in each view.
        names: of AOVs; those without derivatives are left out.
    """
    names = tuple(name for name in names if plain(name) not in UNDIFFERENTIATED)

    def values(integrand: Integrand, start: Onward) -> tuple[Tensor, ...]:
        found = lane_values(integrand, start.paths, tuple(dict.fromkeys(map(plain, group))), start.hit)
        return tuple(channels_of(group, found))

    found: dict[str, Tensor] = {}
    for of_paths in (False, True):
        group = tuple(name for name in names if (plain(name) in OF_PATHS) == of_paths)
        counts = [len(QUANTITIES[plain(name)]) for name in group]
        if group:
            seen = call if of_paths else call._replace(integrand=with_emitters(call.integrand))
            turns = tuple(plain(name) in TURNING for name, count in zip(group, counts) for _ in range(count))
            found |= zip(group, jumps_of_views(seen, jumps, SeenByCamera(turns, values)).split(counts, 1))
    return found


def with_emitters(integrand: Integrand) -> Integrand:
    """The integrand with all emitters visible."""
    return integrand._replace(settings=integrand.settings._replace(hide_emitters=False))
