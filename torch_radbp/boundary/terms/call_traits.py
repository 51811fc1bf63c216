"""What boundary terms ask of a call: whether pixels have an area, mirrors are followed, and what random hits do."""

from __future__ import annotations

from torch_radbp.call.render_call import RenderCall


def films_have_area(call: RenderCall) -> bool:
    """True if pixels of all views have an area; along single rays no borders are seen."""
    return all(view.camera.kind.has_area for view in call.views)


def follows_mirrors(call: RenderCall) -> bool:
    """True if the scene has ideal mirrors or glass, in which cameras may see something."""
    return (call.integrand.max_depth > 1 and any(look.kind.delta for look in call.scene.layout.appearances)
            and films_have_area(call))


def glues(call: RenderCall) -> bool:
    """True if random next hits of paths are fixed to surfaces, except after rough glass."""
    return call.integrand.settings.sampling != "attached"


def follows(call: RenderCall) -> bool:
    """True if some random next hits of paths follow directions that carry derivatives."""
    return not glues(call) or call.integrand.settings.following


def sharp_lights_later(call: RenderCall) -> bool:
    """True if lights without extent are sampled at second or later vertices of paths."""
    settings, lights = call.integrand.settings, call.scene.layout.lights
    return settings.nee and call.integrand.max_depth > 2 and any(kind.delta for kind in lights)
