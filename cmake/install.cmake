# What a user of the package needs; the nodelet's and deblur_bag's rules stand beside their targets.
install(TARGETS gyro_deblur_core LIBRARY DESTINATION ${CATKIN_PACKAGE_LIB_DESTINATION})
foreach(tool calibrate_timing deblur_image evaluate_features make_bag simulate_bag)
  if(TARGET ${tool})
    install(TARGETS ${tool} RUNTIME DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION})
  endif()
endforeach()
install(DIRECTORY include/${PROJECT_NAME}/
  DESTINATION ${CATKIN_PACKAGE_INCLUDE_DESTINATION}
  FILES_MATCHING PATTERN "*.hpp")
install(DIRECTORY config launch rviz workflow
  DESTINATION ${CATKIN_PACKAGE_SHARE_DESTINATION}
  USE_SOURCE_PERMISSIONS
  PATTERN __pycache__ EXCLUDE)
catkin_install_python(PROGRAMS scripts/play_through.py scripts/plot_timing.py scripts/report.py
  DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION})
# What they import is installed beside them. The devel space has relays of the programs, so it has links to these.
foreach(module report_bags.py report_measures.py report_pictures.py report_tables.py)
  install(FILES scripts/${module} DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION})
  file(MAKE_DIRECTORY ${CATKIN_DEVEL_PREFIX}/${CATKIN_PACKAGE_BIN_DESTINATION})
  file(CREATE_LINK ${PROJECT_SOURCE_DIR}/scripts/${module}
    ${CATKIN_DEVEL_PREFIX}/${CATKIN_PACKAGE_BIN_DESTINATION}/${module} SYMBOLIC)
endforeach()

# Not below the source: a devel space of a workspace, which rosrun finds as it is.
if(CATKIN_DEVEL_PREFIX STREQUAL "${PROJECT_SOURCE_DIR}/build/devel")
  catkin_add_env_hooks(50.gyro_deblur_rosrun SHELLS sh DIRECTORY ${PROJECT_SOURCE_DIR}/cmake SKIP_INSTALL)
endif()
