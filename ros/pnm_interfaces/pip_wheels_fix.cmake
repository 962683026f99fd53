# Only for `pip install ./ros/pnm_interfaces`, which builds against the ROS 2 wheels; colcon never reads this file.
# Included after project() through CMAKE_PROJECT_INCLUDE; needs CMake 3.21 for the deferred call.

# pip builds in an environment of its own, whose prefix holds the ament packages; CMake does not know it.
find_package(Python3 REQUIRED COMPONENTS Interpreter)
execute_process(
  COMMAND ${Python3_EXECUTABLE} -c
    "import ament_package, pathlib; print(pathlib.Path(ament_package.__file__).resolve().parents[4], end='')"
  OUTPUT_VARIABLE _prefix
  RESULT_VARIABLE _failed
)
if(NOT _failed AND EXISTS "${_prefix}/share/ament_index/resource_index")
  list(PREPEND CMAKE_PREFIX_PATH "${_prefix}")
  if(NOT "$ENV{AMENT_PREFIX_PATH}" STREQUAL "")
    set(ENV{AMENT_PREFIX_PATH} "${_prefix}:$ENV{AMENT_PREFIX_PATH}")
  else()
    set(ENV{AMENT_PREFIX_PATH} "${_prefix}")
  endif()
endif()

# The wheels' imported targets name include directories of the machine they were built on, which CMake
# refuses at generate time. They hold Python and numpy headers that nothing here needs from there.
function(_drop_missing_includes)
  get_property(_targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(_target IN LISTS _targets)
    get_target_property(_includes ${_target} INTERFACE_INCLUDE_DIRECTORIES)
    if(_includes)
      set(_kept)
      foreach(_directory IN LISTS _includes)
        if(_directory MATCHES "^\\$<" OR EXISTS "${_directory}")
          list(APPEND _kept "${_directory}")
        endif()
      endforeach()
      set_target_properties(${_target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${_kept}")
    endif()
  endforeach()
endfunction()
cmake_language(DEFER CALL _drop_missing_includes)
