# Only matters where ROS 2 comes from Python wheels; a no-op on an apt-installed ROS 2.
# 1. No setup.bash exists there, so point the ament index at the Python environment.
# 2. The wheels' exported *__rosidl_generator_py targets name include directories of the machine
#    they were built on: drop the ones that do not exist. The check CMake makes on them comes at
#    generate time, so a deferred call is early enough and no installed file is touched.
if(NOT DEFINED ENV{AMENT_PREFIX_PATH})
  find_program(_ros_wheels_python NAMES python3 python)
  execute_process(
    COMMAND "${_ros_wheels_python}" -c "import sys; print(sys.prefix)"
    OUTPUT_VARIABLE _ros_wheels_prefix
    OUTPUT_STRIP_TRAILING_WHITESPACE)
  if(EXISTS "${_ros_wheels_prefix}/share/ament_index")
    set(ENV{AMENT_PREFIX_PATH} "${_ros_wheels_prefix}")
    list(PREPEND CMAKE_PREFIX_PATH "${_ros_wheels_prefix}")
  endif()
endif()

function(_ros_wheels_drop_missing_includes)
  get_property(_targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(_target IN LISTS _targets)
    get_target_property(_dirs ${_target} INTERFACE_INCLUDE_DIRECTORIES)
    if(NOT _dirs)
      continue()
    endif()
    set(_keep "")
    foreach(_dir IN LISTS _dirs)
      if(NOT _dir MATCHES "^/" OR EXISTS "${_dir}")
        list(APPEND _keep "${_dir}")
      endif()
    endforeach()
    set_target_properties(${_target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${_keep}")
  endforeach()
endfunction()
cmake_language(DEFER CALL _ros_wheels_drop_missing_includes)

# A wheel is for Python, which needs the type support of C only. That of C++ is three fifths of what
# there is to compile.
macro(ros_wheels_leave_out_cpp)
  if(FOR_PYTHON_ONLY)
    list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "cpp:")
  endif()
endmacro()

# What most files of the wheel spend their time on is the same headers: a dozen files are compiled as
# one. Not those of rosidl_generator_c, which name static variables alike.
function(ros_wheels_compile_together)
  if(FOR_PYTHON_ONLY)
    foreach(_part rosidl_typesupport_fastrtps_c rosidl_typesupport_introspection_c
                  rosidl_typesupport_c rosidl_generator_py)
      set_target_properties(${PROJECT_NAME}__${_part} PROPERTIES
        UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 12)
    endforeach()
  endif()
endfunction()
