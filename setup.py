"""All metadata of the package, here and not in a [project] table, because colcon reads setup.py."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "squeal_rig"
SHARE = f"share/{NAME}"


def files(target: str, *patterns: str) -> tuple[str, list[str]]:
    """One entry of data_files: what the patterns find, copied into the folder `target` of the prefix."""
    here = Path()
    return target, sorted(str(path) for pattern in patterns for path in here.glob(pattern) if path.is_file())


def tree(folder: str) -> list[tuple[str, list[str]]]:
    """Entries of data_files for the YAML files in `folder` and below, each in its own folder under share/."""
    folders = [Path(folder), *(path for path in sorted(Path(folder).rglob("*")) if path.is_dir())]
    return [files(f"{SHARE}/{path}", f"{path}/*.yaml", f"{path}/*.xml", f"{path}/*.json") for path in folders]


setup(
    name=NAME,
    version="0.1.0",
    description="A brake squeal test rig in ROS 2: virtual pad and belt, friction, stability, recording.",
    # Beside the real file: colcon's --symlink-install runs a link to this one elsewhere.
    long_description=Path(__file__).resolve().with_name("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    classifiers=[
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        "Topic :: Scientific/Engineering :: Physics",
    ],
    python_requires=">=3.10",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "page/static/*"]},
    data_files=[
        files("share/ament_index/resource_index/packages", f"resource/{NAME}"),
        files(SHARE, "package.xml"),
        files(f"{SHARE}/launch", "launch/*.launch.py"),
        *tree("config"),
        # `ros2 run` looks for executables here and nowhere else.
        files(f"lib/{NAME}", "scripts/*"),
    ],
    # The lower bounds are what Ubuntu 24.04 ships, the home of ROS 2 Jazzy; all install on Python 3.10.
    install_requires=[
        "lz4>=4.0.2",
        "matplotlib>=3.6.3",
        "mcap>=1.2.1",
        "mcap-ros2-support>=0.5.5",
        "numba>=0.58.1",
        "numpy>=1.26.4",
        "PyYAML>=6.0.1",
        "rich>=13.7.1",
        "ruamel.yaml>=0.17.21",
        "scipy>=1.11.4",
        "typer>=0.9.0",
        "zstandard>=0.22.0",
    ],
    extras_require={
        # Wheels for Linux on x86-64 only. No marker says so: elsewhere pip is to fail, not to leave ROS out.
        "jazzy": [
            "ros-jazzy-common-interfaces>=5.3.6",
            "ros-jazzy-rclpy>=7.1.6",
            "ros-jazzy-rmw-fastrtps-cpp>=8.4.3",
        ],
        # `squeal-rig bag export` to Parquet and HDF5, and the readers for notebooks.
        "export": ["h5py>=3.10", "pandas>=2.1", "pyarrow>=14.0"],
        # `squeal-rig page`, `squeal-rig run --page` and the node `page`.
        "page": ["aiohttp>=3.9.1"],
        # The node `foxglove`.
        "foxglove": ["foxglove-sdk>=0.25"],
        # `squeal-rig campaign`: tables, a cluster here or elsewhere, Sobol indices.
        "campaign": ["dask>=2024.1", "distributed>=2024.1", "pyarrow>=14.0", "SALib>=1.5"],
        # The driver `opendaq`: acquisition from openDAQ devices, inverter and preload unit over Modbus TCP.
        "hardware": ["opendaq>=3.40,<4", "pymodbus>=3.13,<4"],
        "test": [
            "SALib>=1.5",
            "aiohttp>=3.9.1",
            "axe-playwright-python>=0.1.4",
            "dask>=2024.1",
            "distributed>=2024.1",
            "foxglove-sdk>=0.25",
            "h5py>=3.10",
            "hypothesis>=6.100",
            "opendaq>=3.40,<4",
            "pandas>=2.1",
            "playwright>=1.49",
            "psutil>=5.9",
            "pyarrow>=14.0",
            "pymodbus>=3.13,<4",
            "pytest>=8.0",
            "pytest-xdist>=3.5",
            "rosbags>=0.10.11",
            "setuptools>=70.1",  # builds the package, to list what is in it
        ],
        # Peers of the benchmarks. numbalsoda builds with gfortran; without it `make bench` goes on and says so.
        "bench": ["diffrax>=0.6", "heyoka>=7.0", "jax>=0.4.30"],
        # Pinned to a minor version: another one may format or judge the same code differently.
        "lint": ["import-linter>=2.15,<3", "mypy>=2.4,<2.5", "ruff>=0.17.6,<0.18"],
        # `make docs-site`. With another theme, and without the notebooks, the pages build without the last two.
        "docs": ["sphinx>=7.2", "myst-parser>=3.0", "furo>=2024.1", "myst-nb>=1.1", "ipykernel>=6.29"],
        # What `make dist` and `make audit` build and check the package with.
        "dist": ["build>=1.2", "pip-audit>=2.7", "twine>=6.1"],
        # colcon still calls setup.py, with options that setuptools 80 has dropped.
        "colcon": ["colcon-common-extensions", "colcon-core", "colcon-ros", "setuptools<80"],
    },
    entry_points={
        "console_scripts": ["squeal-rig = squeal_rig.cli:main"],
        "squeal_rig.drivers": [
            "virtual = squeal_rig.instruments.virtual:VirtualRig",
            "bag = squeal_rig.drivers.bag:BagRig",
            "opendaq = squeal_rig.drivers.hardware:HardwareRig",
        ],
        # Options of the driver contract suite, in runs that name it and in no other.
        "pytest11": ["squeal_rig_driver_contract = squeal_rig.testing.contract_options"],
    },
)
