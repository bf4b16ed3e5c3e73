# What others need of the package. With catkin the rules of the nodelet and deblur_bag stand next to their targets.
if(GYRO_DEBLUR_ROS)
  set(library_folder ${CATKIN_PACKAGE_LIB_DESTINATION})
  set(program_folder ${CATKIN_PACKAGE_BIN_DESTINATION})
  set(header_folder ${CATKIN_PACKAGE_INCLUDE_DESTINATION})
  set(config_folders ${CATKIN_PACKAGE_SHARE_DESTINATION}/cmake)
  # There Debian's catkin puts the package's configuration next to the libraries.
  if(CMAKE_INSTALL_PREFIX STREQUAL "/usr")
    list(APPEND config_folders ${CATKIN_GLOBAL_LIB_DESTINATION}/cmake/${PROJECT_NAME})
  endif()
  set(build_config_folder ${CATKIN_DEVEL_PREFIX}/share/${PROJECT_NAME}/cmake)
else()
  include(GNUInstallDirs)
  set(library_folder ${CMAKE_INSTALL_LIBDIR})
  set(program_folder ${CMAKE_INSTALL_BINDIR})
  set(header_folder include/${PROJECT_NAME})
  set(config_folders ${CMAKE_INSTALL_LIBDIR}/cmake/${PROJECT_NAME})
  set(build_config_folder ${PROJECT_BINARY_DIR})
endif()

# The core as a library: target gyro_deblur::gyro_deblur_core, from the build (with catkin: the devel space) and
# installed. `cmake --install BUILD --component core` installs it alone.
install(TARGETS gyro_deblur_core EXPORT gyro_deblurTargets LIBRARY DESTINATION ${library_folder} COMPONENT core)
install(DIRECTORY include/${PROJECT_NAME}/
  DESTINATION ${header_folder} COMPONENT core
  FILES_MATCHING PATTERN "*.hpp")
export(EXPORT gyro_deblurTargets NAMESPACE gyro_deblur:: FILE ${build_config_folder}/gyro_deblurTargets.cmake)
foreach(folder IN LISTS config_folders)
  install(EXPORT gyro_deblurTargets NAMESPACE gyro_deblur:: DESTINATION ${folder} COMPONENT core)
endforeach()
if(NOT GYRO_DEBLUR_ROS)
  # Else catkin_package() makes both files.
  include(CMakePackageConfigHelpers)
  configure_file(cmake/gyro_deblur-extras.cmake ${build_config_folder}/gyro_deblurConfig.cmake COPYONLY)
  write_basic_package_version_file(${build_config_folder}/gyro_deblurConfigVersion.cmake
    COMPATIBILITY SameMinorVersion)
  #catkin_lint: ignore_once missing_file wrong_install_destination
  install(FILES ${build_config_folder}/gyro_deblurConfig.cmake ${build_config_folder}/gyro_deblurConfigVersion.cmake
    DESTINATION ${config_folders} COMPONENT core)
endif()

foreach(tool calibrate deblur_image evaluate_features make_bag simulate_bag)
  if(TARGET ${tool})
    install(TARGETS ${tool} RUNTIME DESTINATION ${program_folder})
    if(NOT GYRO_DEBLUR_ROS)
      set_target_properties(${tool} PROPERTIES INSTALL_RPATH "$ORIGIN/../${CMAKE_INSTALL_LIBDIR}")
    endif()
  endif()
endforeach()
if(NOT GYRO_DEBLUR_ROS)
  return()
endif()

# genpy compiles the modules, which then name the build's folders. Python compiles what it imports.
foreach(folder "" /cfg /msg)
  install(CODE "file(REMOVE_RECURSE \"\$ENV{DESTDIR}\${CMAKE_INSTALL_PREFIX}/${CATKIN_PACKAGE_PYTHON_DESTINATION}${folder}/__pycache__\")")
endforeach()
# openvins/ is a package of its own, which is built elsewhere.
install(DIRECTORY config launch openvins rviz workflow
  DESTINATION ${CATKIN_PACKAGE_SHARE_DESTINATION}
  USE_SOURCE_PERMISSIONS
  PATTERN __pycache__ EXCLUDE)
# Programs of the installation and of the devel space. Not executable in scripts/: rosrun would find them twice.
catkin_install_python(
  PROGRAMS scripts/bag_transport.py scripts/play_bag.py scripts/plot_calibration.py scripts/report.py scripts/setup
  DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION})
# What they import is installed next to them. The devel space has relays of the programs, so it has links to these.
foreach(module bag_input.py live_inputs.py missing_packages.py report_bags.py report_measures.py report_pictures.py
        report_tables.py wanted_motion.py)
  install(FILES scripts/${module} DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION})
  file(MAKE_DIRECTORY ${CATKIN_DEVEL_PREFIX}/${CATKIN_PACKAGE_BIN_DESTINATION})
  file(CREATE_LINK ${PROJECT_SOURCE_DIR}/scripts/${module}
    ${CATKIN_DEVEL_PREFIX}/${CATKIN_PACKAGE_BIN_DESTINATION}/${module} SYMBOLIC)
endforeach()

# Not below the source: a devel space of a workspace, which rosrun finds as it is.
if(CATKIN_DEVEL_PREFIX STREQUAL "${PROJECT_SOURCE_DIR}/build/devel")
  catkin_add_env_hooks(50.gyro_deblur_rosrun SHELLS sh DIRECTORY ${PROJECT_SOURCE_DIR}/cmake SKIP_INSTALL)
endif()
