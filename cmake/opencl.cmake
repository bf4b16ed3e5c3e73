# The OpenCL engine, where the loader, the C++ bindings and the C headers are. The kernels are compiled at run time from
# the source that is embedded here.
find_package(OpenCL 1.2 QUIET)
find_path(GYRO_DEBLUR_OPENCL_CXX_DIR NAMES CL/opencl.hpp CL/cl2.hpp HINTS ${OpenCL_INCLUDE_DIRS})
mark_as_advanced(GYRO_DEBLUR_OPENCL_CXX_DIR)
if(OpenCL_FOUND AND GYRO_DEBLUR_OPENCL_CXX_DIR)
  option(GYRO_DEBLUR_OPENCL "Build the OpenCL engine" ON)
elseif(NOT DEFINED GYRO_DEBLUR_OPENCL)
  message(WARNING "OpenCL is not found: the engine opencl is left out. Install ocl-icd-opencl-dev and opencl-headers, or "
                  "set -DGYRO_DEBLUR_OPENCL=OFF")
endif()
set(opencl_folder ${PROJECT_SOURCE_DIR}/src/engine/opencl)
if(GYRO_DEBLUR_OPENCL)
  set(opencl_source ${opencl_folder}/line_convolution.cl)
  set(embedded_source ${CMAKE_CURRENT_BINARY_DIR}/line_convolution.cl.cpp)
  set(embed_script ${PROJECT_SOURCE_DIR}/cmake/embed_text.cmake)
  add_custom_command(OUTPUT ${embedded_source}
    COMMAND ${CMAKE_COMMAND} -D INPUT=${opencl_source} -D OUTPUT=${embedded_source}
            -D VARIABLE=kLineConvolutionSource -P ${embed_script}
    DEPENDS ${opencl_source} ${embed_script}
    COMMENT "Embedding line_convolution.cl" VERBATIM)
  target_sources(gyro_deblur_engine PRIVATE ${opencl_folder}/opencl_engine.cpp ${embedded_source})
  target_include_directories(gyro_deblur_engine SYSTEM PRIVATE ${GYRO_DEBLUR_OPENCL_CXX_DIR})
  target_link_libraries(gyro_deblur_engine PRIVATE OpenCL::OpenCL)
else()
  target_sources(gyro_deblur_engine PRIVATE ${opencl_folder}/opencl_absent.cpp)
endif()
