# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Set-up names this file as CMAKE_PROJECT_INCLUDE_BEFORE. The sources that rosidl generates for Fast DDS, one a
# message, are compiled as one, since each includes the same large headers: it halves the time of the build.
function(join_sources)
  get_directory_property(targets BUILDSYSTEM_TARGETS)
  foreach(target IN LISTS targets)
    if(target MATCHES "__rosidl_typesupport_fastrtps_(c|cpp)$")
      set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 0)
    endif()
  endforeach()
endfunction()
cmake_language(DEFER CALL join_sources)
