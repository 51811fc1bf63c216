"""Three estimators of what smoke lets through: ``python -m benchmarks.transmittance``.

Straight ways through smoke, as connections to lights are: by ratio tracking, by residual ratio tracking as
`torch_radbp/medium/heterogeneous.py` has it (the least extinction of each coarse cell counts in closed form), and by a power
series of a fixed number of samples (Kettunen, d'Eon, Pantaleoni and Novak 2021, "An Unbiased Ray-Marching Transmittance
Estimator", algorithms 1 and 4). For each the mean over rays of the variance, the mean number of times that extinction is
looked up, and the product of both, by which an estimator costs what it costs.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable

import torch
from torch import Tensor

import torch_radbp as rb
from torch_radbp.interface.medium import Tracking
from torch_radbp.io.build import build_plugin
from torch_radbp.tensors.vec import Ray, Vec3
from torch_radbp.volume.grid import GridKind

SIDE = 32  # cells
ORDER, GOES_ON = 2.0, 0.9  # of the series: up to which all are summed, and with which probability any but the first are


def grids(scale: float) -> dict[str, Tensor]:
    """Densities, (Z, Y, X)."""
    plume = build_plugin({"type": "gridvolume", "filename": str(rb.asset("shapes/plume.vol"))}, "volume").data
    plume = plume.detach()[..., 0].double()
    z, y, x = torch.meshgrid(*(torch.linspace(-1, 1, SIDE, dtype=torch.float64),) * 3, indexing="ij")
    waves = 0.3 * torch.sin(5 * x) * torch.sin(4 * y + 1) * torch.sin(6 * z)
    cloud = (1.2 - (x * x + y * y + z * z).sqrt() + waves).clamp(0, 1)
    haze = 0.5 + 0.1 * torch.sin(7 * x) * torch.sin(5 * y)
    return {"plume": plume / plume.max() * scale, "cloud": cloud * scale, "haze": haze * scale}


def medium_of(grid: Tensor):
    """The functions of a medium, and its table."""
    medium = build_plugin({"type": "heterogeneous", "sigma_t": {"type": "gridvolume", "data": grid}}, "medium").double()
    table = medium.row()
    return medium.kind(), table._replace(scale=table.scale.reshape(1))


def rays_through(count: int, generator: torch.Generator) -> tuple[Ray, Tensor]:
    """Rays between points on the walls of the unit cube, and their lengths."""
    ends = torch.rand(2, 3, count, generator=generator, dtype=torch.float64)
    ends[0, 0], ends[1, 0] = 0.0, 1.0
    reach = ends[1] - ends[0]
    length = reach.norm(dim=0)
    return Ray(Vec3(*ends[0]), Vec3(*(reach / length))), length


def tracked(grid: Tensor, residual: bool) -> Callable[[Ray, Tensor, int], tuple[Tensor, Tensor]]:
    """Estimates and lookups by tracking; `residual`: less the least extinction."""
    kind, table = medium_of(grid)
    if not residual:
        table = table._replace(grid=table.grid._replace(least=torch.zeros_like(table.grid.least)))

    def estimate(ray: Ray, length: Tensor, seed: int) -> tuple[Tensor, Tensor]:
        first, last = kind.enter(table, ray, length)
        seeds = torch.randint(-2**31, 2**31, (len(length),), generator=torch.Generator().manual_seed(seed)).int()
        one, looked = Vec3.full(length, 1.0), torch.zeros_like(length)
        on = Tracking(first, torch.full_like(length, torch.inf), one, one, seeds, first < last)
        while on.running.any():
            looked += on.running
            on = kind.step(table, ray, last, length, on, False)
        return on.left.x, looked

    return estimate


def by_series(grid: Tensor) -> Callable[[Ray, Tensor, int], tuple[Tensor, Tensor]]:
    """Estimates and lookups by the series."""
    kind, table = medium_of(grid)
    sigma_kind, largest = GridKind("trilinear", "clamp"), float(grid.max())

    def depths(ray: Ray, length: Tensor, comb: int, generator: torch.Generator) -> Tensor:
        """Less the optical thickness, by one comb of samples."""
        total, offset = torch.zeros_like(length), torch.rand(len(length), generator=generator, dtype=torch.float64)
        for tooth in range(comb):
            t = (tooth + offset) / comb * length
            total -= sigma_kind.values(table.sigma_t, ray.o + ray.d * t)[0]
        return total * (length / comb)

    def estimate(ray: Ray, length: Tensor, seed: int) -> tuple[Tensor, Tensor]:
        generator = torch.Generator().manual_seed(seed)
        orders, weights = order_and_weights(len(length), generator)
        thick = largest * length
        samples = ((0.015 + thick) * (0.65 + thick) * (60.3 + thick))**(1 / 3)
        found, looked = torch.zeros_like(length), torch.zeros_like(length)
        comb = (samples / (orders + 1)).ceil().clamp_min(1).long()
        for order in orders.unique().tolist():
            for teeth in comb[orders == order].unique().tolist():
                some = ((orders == order) & (comb == teeth)).nonzero().squeeze(1)
                own = Ray(*(part.map(lambda c, some=some: c[some]) for part in ray))
                x = torch.stack([depths(own, length[some], teeth, generator) for _ in range(order + 1)])
                found[some] = mean_over_pivots(x, weights[:order + 1])
                looked[some] = teeth * (order + 1.0)
        return found, looked

    return estimate


def order_and_weights(count: int, generator: torch.Generator, most: int = 24) -> tuple[Tensor, list[float]]:
    """The order of each estimate, (count,) int64, and what its terms are multiplied with: one over their probability."""
    orders, on = torch.zeros(count, dtype=torch.int64), torch.ones(count, dtype=torch.bool)
    weights, probability = [1.0], 1.0
    for order in range(1, most):
        chance = GOES_ON if order == 1 else min(1.0, ORDER / order)
        probability *= chance
        on = on & (torch.rand(count, generator=generator, dtype=torch.float64) < chance)
        orders[on] = order
        weights.append(1.0 / probability)
    return orders, weights


def mean_over_pivots(x: Tensor, weights: list[float]) -> Tensor:
    """(n,) the estimate of exp of the mean of x, (N + 1, n): series around each of them, in the elementary symmetric means
    of the others."""
    total = torch.zeros_like(x[0])
    for pivot in range(len(x)):
        others = torch.cat([x[:pivot], x[pivot + 1:]]) - x[pivot]
        symmetric = [torch.ones_like(x[0])] + [torch.zeros_like(x[0]) for _ in range(len(others))]
        for other in others:
            for order in range(len(others), 0, -1):
                symmetric[order] = symmetric[order] + symmetric[order - 1] * other
        series = sum(weights[order] * symmetric[order] / (math.comb(len(others), order) * math.factorial(order))
                     for order in range(len(x)))
        total = total + torch.exp(x[pivot]) * series
    return total / len(x)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rays", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=200, help="estimates of each ray")
    parser.add_argument("--scales", type=float, nargs="+", default=[1.0, 5.0, 20.0],
                        help="largest extinctions, of a cube of 1")
    options = parser.parse_args()
    print("| smoke, largest extinction | estimator | mean | variance | lookups | product | over ratio tracking |")
    print("|---|---|---|---|---|---|---|")
    for scale in options.scales:
        for name, grid in grids(scale).items():
            ray, length = rays_through(options.rays, torch.Generator().manual_seed(1))
            first = None
            for kind, estimate in (("ratio", tracked(grid, False)), ("residual ratio", tracked(grid, True)),
                                   ("series", by_series(grid))):
                runs = [estimate(ray, length, seed) for seed in range(options.repeats)]
                values, lookups = (torch.stack(part) for part in zip(*runs))
                variance, looked = float(values.var(0).mean()), float(lookups.mean())
                first = first or variance * looked
                print(f"| {name}, {scale:g} | {kind} | {float(values.mean()):.4f} | {variance:.2e} | {looked:.1f} | "
                      f"{variance * looked:.2e} | {variance * looked / first:.2f} |", flush=True)


if __name__ == "__main__":
    main()
