# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
# Set-up names this file as CMAKE_PROJECT_INCLUDE. It builds messages in a third of the time, while the
# interface packages themselves stay standard ones.

# On ROS wheels only Python reads them, by way of C: code for C++ is not generated.
if(ROS_WHEELS)
  macro(find_package)
    _find_package(${ARGV})
    list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX
      "^rosidl_(generator|typesupport|typesupport_fastrtps|typesupport_introspection)_cpp:")
  endmacro()
endif()

function(change_targets)
  # The wheels export the Python include folder of the machine they were built on, and CMake refuses
  # a folder that does not exist.
  get_directory_property(targets IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(includes ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(includes)
      list(FILTER includes EXCLUDE REGEX "^/opt/python/")
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${includes}")
    endif()
  endforeach()
  # The sources of a library, one a message, include the same large headers, so they are compiled as
  # one. Descriptions of types are left out, since all define the same static names.
  get_directory_property(targets BUILDSYSTEM_TARGETS)
  foreach(target IN LISTS targets)
    if(target MATCHES "__rosidl_(generator_(c|py)|typesupport_(c|introspection_c|fastrtps_c|fastrtps_cpp))$")
      get_target_property(descriptions ${target} SOURCES)
      list(FILTER descriptions INCLUDE REGEX "__description\\.c$")
      set_source_files_properties(${descriptions} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
      set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 0)
    endif()
  endforeach()
endfunction()
cmake_language(DEFER CALL change_targets)
