"""What Warp's kernels have in common: rays in the units of a mesh, and numbers of lanes that only the device knows."""

import warp as wp

LARGEST = wp.constant(1e18)  # of a direction's components, and its inverse: divisions neither overflow nor underflow
FARTHEST = wp.constant(3e38)


@wp.struct
class Query:
    """A ray scaled to the units of the mesh."""

    valid: wp.bool
    o: wp.vec3
    d: wp.vec3  # scaled so that divisions stay in range
    per_t: float  # t in the mesh's units per t of the ray


@wp.func
def factor_of(d: wp.vec3) -> float:
    """The factor that scales a direction so that divisions by it stay in range."""
    largest = wp.max(wp.abs(d))
    return wp.where(largest > LARGEST, 1.0 / LARGEST, wp.where(largest < 1.0 / LARGEST, LARGEST, 1.0))


@wp.func
def query_of(unit: float, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> Query:
    """Scales a ray of the scene by `unit` to the units of the mesh."""
    query = Query()
    query.o = wp.vec3(ox * unit, oy * unit, oz * unit)
    d = wp.vec3(dx, dy, dz)
    factor = factor_of(d)
    query.d = d * factor
    query.valid = wp.isfinite(query.o) and wp.isfinite(d) and wp.max(wp.abs(d)) > 0.0
    query.per_t = unit / factor
    return query


@wp.func
def is_beyond(lane: int, last: wp.array(dtype=wp.int64), rays: wp.array(dtype=wp.int64)) -> bool:
    """True if a thread's lane lies beyond the number of lanes `last[0]`, which thread 0 adds to the count of rays."""
    if not last:
        return False
    if lane == 0:
        wp.atomic_add(rays, 0, last[0])
    return wp.int64(lane) >= last[0]
