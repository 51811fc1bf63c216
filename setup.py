"""Package metadata. `pip install -c constraints.txt .` installs the CPU version; extras are listed below."""

from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

TRAIN = ["kornia>=0.7", "pydantic>=2.5", "rich>=13", "tensorboard>=2.14", "tomli-w>=1.0", "typer>=0.12"]
WARP = "warp-lang>=1.19"
CUDA = [WARP, "cuda-bindings>=12.8"]
BAKE = ["xatlas>=0.0.9"]
DOCS = ["sphinx>=8", "furo>=2024.8", "myst-parser>=4", "jupytext>=1.16", "griffe>=1.5", "matplotlib>=3.8"]
TEST = ["matplotlib>=3.8", "mypy>=1.18", "pytest>=8", "pytest-xdist>=3.7", "ruff>=0.17", "setuptools>=70.1", WARP,
        "lxml>=5", "networkx>=3", "pycollada>=0.8",  # by which trimesh reads 3MF and COLLADA
        *(f"{name}; python_version < '3.14'" for name in BAKE),  # newer ones have no wheel yet
        'nvidia-cuda-nvcc-cu12>=12.8; sys_platform != "darwin"']

TRAINING = "torch_radbp.training"
PARTS = [f"{TRAINING}.{name}" for name in find_packages("training")]
ASSETS = "torch_radbp.assets"  # what the bundled recipes need
ASSET_FILES = ["README.md", "*/scene.xml", "*/target*.exr", "patches.png", "textured_room/*.png", "pot/*.glb",
               "pot/*.exr", "lit_balls/*.exr", "relief/*.exr", "shapes/*", "three_shadows/*.exr", "smoke/*.exr",
               "smoke/*.xml", "cloud/*.exr", "caustic/*.exr", "figurine/*.xml", "figurine/*.ply", "figurine/*.png",
               "figurine/studio.exr", "figurine/on_floor.exr"]

CLASSIFIERS = [
    "Development Status :: 4 - Beta",
    "Intended Audience :: Developers",
    "Intended Audience :: Science/Research",
    "Environment :: Console",
    "Environment :: GPU :: NVIDIA CUDA",
    "Operating System :: POSIX :: Linux",  # where it has run
    *(f"Programming Language :: Python :: 3.{minor}" for minor in (10, 11, 12, 13, 14)),
    "Topic :: Multimedia :: Graphics :: 3D Rendering",
    "Topic :: Scientific/Engineering :: Artificial Intelligence",
    "Topic :: Scientific/Engineering :: Image Processing",
    "Typing :: Typed",
]


class BuildWithoutScripts(build_py):
    """Leaves out the scripts that made the assets."""

    def find_package_modules(self, package, package_dir):
        return [] if package == ASSETS else super().find_package_modules(package, package_dir)


setup(
    name="torch_radbp",
    version="1.0.0rc1",
    description="A differentiable path tracer for PyTorch with memoized adjoint radiance",
    long_description=Path(__file__).with_name("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="MIT",
    license_files=["LICENSE"],
    python_requires=">=3.10",
    classifiers=CLASSIFIERS,
    keywords=["differentiable rendering", "inverse rendering", "path tracing", "PyTorch"],
    packages=[*find_packages(include=["torch_radbp", "torch_radbp.*"]), TRAINING, *PARTS, ASSETS],
    # Side by side in the wheel, as in the repository: recipes name their scenes by ../../assets.
    package_dir={TRAINING: "training", ASSETS: "assets"},
    package_data={"torch_radbp": ["py.typed"], TRAINING: ["recipes/*.toml", "*.md"], ASSETS: ASSET_FILES,
                  "torch_radbp.emitter": ["sunsky_data.npz", "sunsky_data.md"]},
    cmdclass={"build_py": BuildWithoutScripts},
    install_requires=[
        "torch>=2.6",
        "numpy>=1.26",
        'numpy>=2; sys_platform == "win32"',  # whose integers have 64 bits there, as elsewhere
        "embreex>=4.4",
        "llvmlite>=0.45",
        "OpenEXR>=3.3",
        "Pillow>=10",
        "safetensors>=0.4",
        "scipy>=1.11",
        "trimesh>=4.7",  # 4.0 to 4.3 fail under numpy 2, and 4.6 drops what is not finite without a word
        'tomli>=2; python_version < "3.11"',
        "typing_extensions>=4.8",
        *TRAIN,
    ],
    extras_require={"test": TEST, "bake": BAKE, "peer": ["mitsuba==3.9.1", "cholespy>=2"], "cuda": CUDA, "docs": DOCS},
    entry_points={"console_scripts": ["radbp = torch_radbp.training.cli:main"]},
)
