# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The commands, one file each, and the one program `vgps` that runs them.

A command's module has a docstring, which is its help, and two functions: `add_arguments(parser)`
declares its arguments and `run(arguments)` does its work. What is slow to import is imported by
`run`, so that help and errors come at once.
"""
