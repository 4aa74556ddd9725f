# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What a policy is outside training: its own file, its digest, and ONNX in both directions."""
