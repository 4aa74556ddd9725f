# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
import re
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

ROOT = Path(__file__).resolve().parent  # colcon runs a link to this file from its build folder
VERSION = "1.0.0"


def requirements(name: str) -> list[str]:
    """Returns what a file of `requirements` pins, with the later versions that should suit as well.

    These are the minor versions of a release, and the patches of one that begins with 0.
    """
    lines = (ROOT / "requirements" / f"{name}.txt").read_text().splitlines()
    pin = re.compile(r"==(0\.\d+\.\d+|\d+\.\d+)[\d.]*")
    return [pin.sub(r"~=\1", line) for line in lines if line[:1].isalpha()]


# The wheels of ROS, without those that build messages; vgps_msgs has these built.
ROS = [line for line in requirements("ros_wheels") if re.search("rclpy|common-interfaces", line)]
BAGS = requirements("bags")

setup(
    name="vgps_ros",
    version=VERSION,
    description="Teaches robots to move by variational guided policy search, with or without ROS 2",
    long_description=(ROOT / "README.md").read_text() if (ROOT / "README.md").exists() else "",
    long_description_content_type="text/markdown",
    maintainer="vgps_ros maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-b6b9a4b1.example",
    license="Apache-2.0",
    packages=find_packages(include=["vgps_ros", "vgps_ros.*"]),
    package_data={
        "vgps_ros.tasks": ["*/*.xml", "*/*.yaml", "*/*.csv", "*/*.json", "*.json"],
        "vgps_ros.wizard": ["*.template"],
        "vgps_ros.nodes.live": ["*.html"],
        "vgps_ros.views.web": ["*.html", "*.js", "*.json", "parts/*"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/vgps_ros"]),
        ("share/vgps_ros", ["package.xml"]),
        ("share/vgps_ros/config", sorted(glob("config/*.*"))),
        ("share/vgps_ros/config/commanded", sorted(glob("config/commanded/*.yaml"))),
        ("share/vgps_ros/config/security", glob("config/security/*.xml")),
        ("share/vgps_ros/config/security/common", sorted(glob("config/security/common/*.xml"))),
        ("share/vgps_ros/launch", sorted(glob("launch/*.launch.py"))),
        # `ros2 run` looks for executables in lib/<package>: each is `vgps` under another name.
        # An older build may have left links to commands that are gone.
        ("lib/vgps_ros", [f for f in sorted(glob("scripts/executables/*")) if Path(f).exists()]),
    ],
    # colcon and apt do not read these: there rosdep brings what package.xml names.
    install_requires=requirements("base"),
    extras_require={
        "ros": [f"vgps_msgs=={VERSION}", *ROS, *BAGS],
        "bags": BAGS,
        "cluster": requirements("cluster"),
        "live": requirements("live"),
        "onnx": requirements("onnx"),
        "test": ["pytest"],
    },
    python_requires=">=3.10",
    zip_safe=False,
    entry_points={"console_scripts": ["vgps = vgps_ros.programs.__main__:main"]},
)
