# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# The ROS wheels export the Python include folder of the machine they were built on
# (/opt/python/...), and CMake refuses a folder that does not exist. Set-up names this file as
# CMAKE_PROJECT_INCLUDE in the wheel installation, so the interface packages themselves stay standard.
function(drop_foreign_python_includes)
  get_directory_property(targets IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(includes ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(includes)
      list(FILTER includes EXCLUDE REGEX "^/opt/python/")
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${includes}")
    endif()
  endforeach()
endfunction()
cmake_language(DEFER CALL drop_foreign_python_includes)
