# SPDX-License-Identifier: Apache-2.0
# Removes include directories of the form /opt/python/... that do not exist from imported targets.
#
# The ROS 2 wheels on PyPI were built in a manylinux image, and their CMake files still name that
# image's Python headers; CMake refuses to generate with an include directory that is missing.
# Call just before ament_package(). Where ROS 2 is installed normally there is nothing to remove.
function(drop_missing_python_includes)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(includes ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT includes)
      continue()
    endif()
    set(kept "")
    foreach(include IN LISTS includes)
      if(include MATCHES "^/opt/python/" AND NOT EXISTS "${include}")
        continue()
      endif()
      list(APPEND kept "${include}")
    endforeach()
    if(NOT kept STREQUAL includes)
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${kept}")
    endif()
  endforeach()
endfunction()
