from glob import glob

from setuptools import find_packages, setup

NODES = [
    "simulation",
    "trajectory_optimizer",
    "policy_learner",
    "policy_executor",
    "demonstration",
    "recorder",
    "player",
    "visualizer",
]
PROGRAMS = {
    "bag": "vgps_ros.programs.bag",
    "plot": "vgps_ros.programs.plot",
    "train": "vgps_ros.programs.train",
    "evaluate": "vgps_ros.programs.evaluate",
    "experiment": "vgps_ros.programs.experiment",
    "figure": "vgps_ros.programs.figure",
    "find_gait": "vgps_ros.programs.find_gait",
    "train_through_graph": "vgps_ros.programs.train_through_graph",
    "execute_policy": "vgps_ros.programs.execute_policy",
}

setup(
    name="vgps_ros",
    version="0.1.0",
    description="Variational guided policy search on ROS 2",
    maintainer="vgps_ros maintainers",
    maintainer_email="maintainers@vgps-ros.invalid",
    license="Apache-2.0",
    packages=find_packages(include=["vgps_ros", "vgps_ros.*"]),
    package_data={"vgps_ros.tasks": ["*.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/vgps_ros"]),
        ("share/vgps_ros", ["package.xml"]),
        ("share/vgps_ros/config", sorted(glob("config/*.yaml") + glob("config/*.xml"))),
        ("share/vgps_ros/config/walker", glob("config/walker/*.yaml")),
        ("share/vgps_ros/config/security", glob("config/security/*.xml")),
        ("share/vgps_ros/config/security/common", sorted(glob("config/security/common/*.xml"))),
    ],
    # requirements/runtime.txt has the dependencies: pip must not touch a ROS installation.
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [f"{name} = vgps_ros.programs.start_node:main" for name in NODES]
        + [f"{name} = {module}:main" for name, module in PROGRAMS.items()],
    },
)
