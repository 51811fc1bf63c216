"""Vertices at one place are found, and only these."""

import torch

from torch_radbp.shape.welding import cells_of, weld_size, welded


def test_vertices_at_one_place_have_the_first_of_them_and_others_themselves():
    generator = torch.Generator().manual_seed(2)
    places = torch.rand(3000, 3, generator=generator)
    which = torch.cat([torch.arange(3000), torch.randint(3000, (500,), generator=generator)])[
        torch.randperm(3500, generator=generator)]
    vertices = places[which]
    first = torch.full((3000,), 3500).scatter_reduce(0, which, torch.arange(3500), "amin")
    found = welded(cells_of(vertices, weld_size(vertices)))
    assert (first[which] != torch.arange(3500)).sum() == 500
    assert found.dtype == torch.int32 and torch.equal(found.long(), first[which])


def test_vertices_that_lie_apart_are_not_welded():
    vertices = torch.rand(5000, 3, generator=torch.Generator().manual_seed(3))
    assert welded(cells_of(vertices, weld_size(vertices))) is None
    assert welded(cells_of(vertices[:1], 1.0)) is None
