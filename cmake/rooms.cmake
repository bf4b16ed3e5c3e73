# Rooms of the core: one object library each, which sees its own files and those of the rooms before it. A header of a
# later room is not on its include path, so that an include of one does not compile.

# gyro_deblur_see_rooms(TARGET VISIBILITY): the include paths of all rooms so far.
function(gyro_deblur_see_rooms target visibility)
  get_property(rooms GLOBAL PROPERTY GYRO_DEBLUR_ROOMS)
  foreach(room IN LISTS rooms)
    target_include_directories(${target} ${visibility} $<BUILD_INTERFACE:${PROJECT_BINARY_DIR}/rooms/${room}>)
  endforeach()
endfunction()

# gyro_deblur_add_view(ROOM [HEADERS...]): the folder that stands for a room on include paths: links to its own folder
# and to its public headers.
function(gyro_deblur_add_view room)
  set(view ${PROJECT_BINARY_DIR}/rooms/${room})
  file(REMOVE_RECURSE ${view})
  file(MAKE_DIRECTORY ${view}/gyro_deblur)
  file(CREATE_LINK ${PROJECT_SOURCE_DIR}/src/${room} ${view}/${room} SYMBOLIC)
  foreach(header IN LISTS ARGN)
    if(NOT EXISTS ${PROJECT_SOURCE_DIR}/include/gyro_deblur/${header})
      message(FATAL_ERROR "room ${room}: there is no include/gyro_deblur/${header}")
    endif()
    file(CREATE_LINK ${PROJECT_SOURCE_DIR}/include/gyro_deblur/${header} ${view}/gyro_deblur/${header} SYMBOLIC)
  endforeach()
endfunction()

# gyro_deblur_add_room(ROOM SOURCES... [HEADERS...] [LIBRARIES...]): the next room. SOURCES are relative to src/ROOM,
# HEADERS are its public ones, in include/gyro_deblur.
function(gyro_deblur_add_room room)
  cmake_parse_arguments(ARG "" "" "SOURCES;HEADERS;LIBRARIES" ${ARGN})
  gyro_deblur_add_view(${room} ${ARG_HEADERS})
  set_property(GLOBAL APPEND PROPERTY GYRO_DEBLUR_ROOMS ${room})
  list(TRANSFORM ARG_SOURCES PREPEND ${PROJECT_SOURCE_DIR}/src/${room}/)
  add_library(gyro_deblur_${room} OBJECT ${ARG_SOURCES})
  gyro_deblur_see_rooms(gyro_deblur_${room} PRIVATE)
  target_include_directories(gyro_deblur_${room} SYSTEM PRIVATE ${OpenCV_INCLUDE_DIRS})
  target_link_libraries(gyro_deblur_${room} PRIVATE Eigen3::Eigen ${ARG_LIBRARIES} gyro_deblur_warnings)
  if(GYRO_DEBLUR_FUZZERS AND NOT room MATCHES "^(base|motion|config)$")
    # Numerics: what a fuzzer looks for is in what reads data, and counting branches makes them much slower.
    # All that fuzzer-no-link stands for; without it precompiled headers do not fit.
    target_compile_options(gyro_deblur_${room} PRIVATE
      -fno-sanitize-coverage=inline-8bit-counters,indirect-calls,trace-cmp,pc-table,stack-depth)
  endif()
  get_property(rooms GLOBAL PROPERTY GYRO_DEBLUR_ROOMS)
  list(GET rooms 0 first_room)
  if(room STREQUAL first_room)
    gyro_deblur_precompile(gyro_deblur_${room} ${gyro_deblur_core_headers})
  else()
    gyro_deblur_use_precompiled(gyro_deblur_${room} gyro_deblur_${first_room})
  endif()
endfunction()

# gyro_deblur_show_view(TARGET ROOM): the include path of one view, for the target and those who link it.
function(gyro_deblur_show_view target room)
  target_include_directories(${target} PUBLIC $<BUILD_INTERFACE:${PROJECT_BINARY_DIR}/rooms/${room}>)
endfunction()

# gyro_deblur_live_in(TARGET ROOM): a library around the core, which sees the whole core and its own files, as do those
# who link it.
function(gyro_deblur_live_in target room)
  gyro_deblur_add_view(${room})
  gyro_deblur_see_rooms(${target} PUBLIC)
  gyro_deblur_show_view(${target} ${room})
endfunction()

# gyro_deblur_compile_for_instruction_sets(ROOM STEM): adds STEM_avx2.cpp and STEM_avx512.cpp where they can run. Which
# copy does is decided at run time. GCC 12 warns about its own AVX-512 header (GCC bug 105593).
function(gyro_deblur_compile_for_instruction_sets room stem)
  if(NOT CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
    return()
  endif()
  set(path ${PROJECT_SOURCE_DIR}/src/${room}/${stem})
  target_sources(gyro_deblur_${room} PRIVATE ${path}_avx2.cpp ${path}_avx512.cpp)
  set_source_files_properties(${path}_avx2.cpp PROPERTIES SKIP_PRECOMPILE_HEADERS ON COMPILE_OPTIONS "-mavx2;-mfma")
  set_source_files_properties(${path}_avx512.cpp PROPERTIES SKIP_PRECOMPILE_HEADERS ON
    COMPILE_OPTIONS "-mavx512f;-mavx512bw;-mavx512vl;-mavx512dq;-mavx512vnni;-mavx512vbmi;-mavx2;-mfma;-mprefer-vector-width=512;-Wno-maybe-uninitialized")
endfunction()
