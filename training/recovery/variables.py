"""What the optimiser sees in the place of a parameter: parametrisations of scene parameters, by a recipe's words."""

from torch import Tensor, nn
from torch.nn.utils import parametrize

from torch_radbp import optim
from torch_radbp.emitter.envmap import Envmap
from torch_radbp.shape.mesh import Mesh
from torch_radbp.texture.bitmap import Bitmap
from torch_radbp.texture.neural import NeuralTexture
from torch_radbp.training import recipe_parameter as recipe
from torch_radbp.training.recovery.network import OnBitmap, make_texels
from torch_radbp.training.recovery.rigid import Rigid
from torch_radbp.volume.gridvolume import GridVolume

SMOOTHNESS = 19.0  # of large steps, if the recipe does not say


def check_fit(module: nn.Module, attribute: str, spec: recipe.Parameter, name: str) -> None:
    """Raises ValueError if a parameter is not of the kind that its parametrisation is for."""
    kind = f"and parameter {name!r} is the {attribute} of a {type(module).__name__}"
    if spec.parametrisation == "network" and not (isinstance(module, (Bitmap, GridVolume)) and attribute == "data"):
        raise ValueError(f'parametrisation = "network" is for the data of bitmaps and grids, {kind}; name the data of '
                         f"one, or take another parametrisation")
    if spec.parametrisation == "large_steps" and not is_shape(module, attribute):
        raise ValueError(f'parametrisation = "large_steps" is for the vertex_positions of meshes, {kind}')
    axes = len(spec.coarse_to_fine.cells) if spec.coarse_to_fine else 0
    if axes and getattr(module, attribute).dim() != axes + 1:
        raise ValueError(f"parameter {name!r}: coarse_to_fine with {axes} numbers of cells is for maps of {axes} axes and "
                         f"channels, this one has shape {tuple(getattr(module, attribute).shape)}")


def is_shape(module: nn.Module, attribute: str) -> bool:
    """Whether a parameter is the vertices of a mesh."""
    return isinstance(module, Mesh) and attribute == "vertex_positions"


def wraps(module: nn.Module) -> tuple[bool, bool]:
    """Whether the last row, and the last column, of a module's map is beside the first."""
    repeats = isinstance(module, Bitmap) and module.wrap_mode == "repeat"
    return repeats, repeats or isinstance(module, Envmap)


def put_variables(scene: nn.Module, module: nn.Module, attribute: str, spec: recipe.Parameter) -> nn.Module | None:
    """Registers the parametrisation of a parameter that has its initial value.

    Returns:
        what the scene has in the place of the module from now on, a network; None: the module itself.
    """
    held = getattr(module, attribute)
    parametrisation = _range(spec)
    if spec.coarse_to_fine is not None:
        parametrisation = optim.CoarseToFine(spec.coarse_to_fine.cells, *wraps(module), within=parametrisation).to(held)
    elif spec.parametrisation == "rigid":
        parametrisation = Rigid(held, spec.pivot)
    elif spec.parametrisation == "large_steps":
        parametrisation = optim.LargeSteps(module.faces, held, spec.smoothness or SMOOTHNESS)
    elif spec.parametrisation == "network":
        parametrisation = make_texels(spec, held)
    if parametrisation is not None:
        parametrize.register_parametrization(module, attribute, parametrisation)
    if spec.parametrisation != "network" or not isinstance(module, Bitmap):
        return None
    stand_in = NeuralTexture(OnBitmap(parametrisation.network, module.parametrizations[attribute].original, module))
    replace(scene, module, stand_in)
    return stand_in


def _range(spec: recipe.Parameter) -> nn.Module | None:
    if spec.parametrisation == "sigmoid":
        return optim.Sigmoid(*spec.bounds)
    return optim.Log() if spec.parametrisation == "log" else None


def follow_positions(mesh: Mesh) -> None:
    """Lets the normals of a mesh follow its vertices from now on, as Mitsuba does whenever these change."""
    if mesh.has_normals:
        del mesh.vertex_normals
        mesh.has_normals, mesh.recompute_normals = False, True


def refine_to(module: nn.Module, attribute: str, size: tuple[int, ...], optimizer=None) -> None:
    """Doubles the grid of a map that is optimised coarse to fine until it has a size; the map stays what it is."""
    while module.parametrizations[attribute][0].size != size:
        optim.refine(module, attribute, optimizer)


def replace(scene: nn.Module, old: nn.Module, new: nn.Module) -> None:
    """Puts a module wherever another one stands in a scene."""
    for holder in list(scene.modules()):
        for name, child in list(holder.named_children()):
            if child is old:
                setattr(holder, name, new)


def original(module: nn.Module, attribute: str) -> Tensor:
    """The leaf that the optimiser changes."""
    if parametrize.is_parametrized(module, attribute):
        return module.parametrizations[attribute].original
    return getattr(module, attribute)
