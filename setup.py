# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

# colcon runs a link to this file from its build folder.
RUNTIME = Path(__file__).resolve().parent / "requirements" / "runtime.txt"

setup(
    name="vgps_ros",
    version="1.0.0",
    description="Variational guided policy search on ROS 2",
    maintainer="vgps_ros maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-b6b9a4b1.example",
    license="Apache-2.0",
    packages=find_packages(include=["vgps_ros", "vgps_ros.*"]),
    package_data={
        "vgps_ros.tasks": ["*/*.xml", "*/*.yaml", "*/*.csv", "*.json", "*.template"],
        "vgps_ros.nodes.live": ["*.html"],
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
    # Without an extra nothing is installed along: pip must not touch a ROS installation.
    extras_require={
        "standalone": [line for line in RUNTIME.read_text().splitlines() if line[:1].isalpha()],
        "test": ["pytest"],
    },
    python_requires=">=3.10",
    zip_safe=False,
    entry_points={"console_scripts": ["vgps = vgps_ros.programs.__main__:main"]},
)
