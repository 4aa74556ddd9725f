# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A page on which anyone drives an exported policy in a browser."""

PAGE_FILES = ("index.html", "policy.onnx", "robot.xml")
