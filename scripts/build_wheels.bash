#!/usr/bin/env bash
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# build_wheels.bash [FOLDER]: builds two wheels, into dist/ if no folder is named. vgps_ros is pure Python
# and brings its pages along. vgps_msgs holds the messages that set-up has built against the ROS 2 wheels,
# for this version of Python: ours, and those that the wheels lack. With both, the graph runs without a
# compiler, CMake or colcon.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
cd "$root"
if [[ -f .venv/ros_setup ]]; then
  printf "wheels: this checkout was set up with an installation of ROS; build wheels in a clone that was set up without one.\n" >&2
  exit 1
fi
dist=$(realpath -m "${1:-dist}")
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
log=$root/log/setup/wheels_built.log
mkdir -p "$dist" "$(dirname "$log")"

# pip would leave its build folder in the checkout, where that of colcon is.
wheel() { # wheel FOLDER: builds the wheel of the package in a folder
  if ! .venv/bin/python -m pip --disable-pip-version-check wheel --quiet --no-deps --no-build-isolation \
    --wheel-dir "$dist" "$1" >"$log" 2>&1; then
    printf 'wheels: %s cannot be built; the end of %s:\n' "${1##*/}" "$log" >&2
    tail -n 30 "$log" >&2
    exit 1
  fi
}

mkdir "$scratch/vgps_ros"
git ls-files --cached --others --exclude-standard -z vgps_ros config launch resource scripts requirements setup.py package.xml README.md LICENSE |
  xargs -0 cp --parents --no-dereference -t "$scratch/vgps_ros"
cp -r vgps_ros/views/web/parts "$scratch/vgps_ros/vgps_ros/views/web"
# A link is no file for a wheel: each executable becomes a copy.
cp --remove-destination -L scripts/executables/* "$scratch/vgps_ros/scripts/executables"
wheel "$scratch/vgps_ros"

mkdir "$scratch/vgps_msgs"
for prefix in install/*_msgs install/*_interfaces; do
  cp -rL "$prefix"/lib/python3*/site-packages/"${prefix##*/}" "$scratch/vgps_msgs"
  mkdir -p "$scratch/vgps_msgs/prefix/share"
  cp -rL "$prefix/lib" "$scratch/vgps_msgs/prefix"
  cp -rL "$prefix"/share/{ament_index,"${prefix##*/}"} "$scratch/vgps_msgs/prefix/share"
done
rm -rf "$scratch"/vgps_msgs/prefix/{lib/python3*,share/*/cmake,share/*/environment}
cat >"$scratch/vgps_msgs/setup.py" <<'PY'
from pathlib import Path

from setuptools import Distribution, find_packages, setup


class Compiled(Distribution):
    def has_ext_modules(self):
        return True


files = [path for path in Path("prefix").rglob("*") if path.is_file()]
pins = (Path("ros_wheels.txt").read_text()).splitlines()
setup(
    name="vgps_msgs",
    version="1.0.0",
    description="Messages of vgps_ros for ROS 2 Jazzy from wheels, with those that the wheels lack",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={"": ["*.so"]},
    data_files=[(str(file.parent.relative_to("prefix")), [str(file)]) for file in files],
    install_requires=[pin for pin in pins if "rclpy" in pin or "common-interfaces" in pin],
    distclass=Compiled,
)
PY
cp requirements/ros_wheels.txt "$scratch/vgps_msgs"
wheel "$scratch/vgps_msgs"
printf 'wheels: %s\n' "$dist"/*.whl
