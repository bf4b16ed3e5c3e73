# What a user of the package needs; the nodelet's and deblur_bag's rules stand beside their targets.
if(NOT GYRO_DEBLUR_ROS)
  include(GNUInstallDirs)
  set(CATKIN_PACKAGE_LIB_DESTINATION ${CMAKE_INSTALL_LIBDIR})
  set(CATKIN_PACKAGE_BIN_DESTINATION ${CMAKE_INSTALL_BINDIR})
  set(CATKIN_PACKAGE_INCLUDE_DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/${PROJECT_NAME})
  set(CATKIN_PACKAGE_SHARE_DESTINATION ${CMAKE_INSTALL_DATADIR}/${PROJECT_NAME})
endif()

install(TARGETS gyro_deblur_core LIBRARY DESTINATION ${CATKIN_PACKAGE_LIB_DESTINATION})
foreach(tool deblur_image make_bag simulate_bag)
  if(TARGET ${tool})
    install(TARGETS ${tool} RUNTIME DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION})
  endif()
endforeach()
install(DIRECTORY include/${PROJECT_NAME}/ DESTINATION ${CATKIN_PACKAGE_INCLUDE_DESTINATION}
        FILES_MATCHING PATTERN "*.hpp")
install(DIRECTORY config launch rviz DESTINATION ${CATKIN_PACKAGE_SHARE_DESTINATION})
if(GYRO_DEBLUR_ROS)
  catkin_install_python(PROGRAMS scripts/play_through.py scripts/report.py
                        DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION})
endif()
