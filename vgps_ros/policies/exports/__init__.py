# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Policies outside training: their own files and digests, and ONNX."""
