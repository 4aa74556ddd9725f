#!/usr/bin/env bash
# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Puts the copyright line into each source file that lacks it. ruff (CPY001) checks the Python files.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

line='# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0'
git ls-files '*.py' '*.bash' '*.cmake' .ci/run scripts/executable scripts/bin/ros2 |
  while read -r file; do
    if [[ -s $file ]] && ! head -n 2 "$file" | grep -q SPDX-License-Identifier; then
      # Below a line that names the interpreter, else at the top.
      sed -i -e "1{/^#!/!s|^|$line\n|}" -e "1{/^#!/s|\$|\n$line|}" "$file"
    fi
  done
