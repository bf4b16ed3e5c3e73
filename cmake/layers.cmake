# Layers of the core: one object library each, which sees its own files and those of the layers before it. A header of a
# later layer is not on its include path, so that an include of one does not compile.

# gyro_deblur_see_layers(TARGET VISIBILITY): the include paths of all layers so far.
function(gyro_deblur_see_layers target visibility)
  get_property(layers GLOBAL PROPERTY GYRO_DEBLUR_LAYERS)
  foreach(layer IN LISTS layers)
    target_include_directories(${target} ${visibility} $<BUILD_INTERFACE:${PROJECT_BINARY_DIR}/layers/${layer}>)
  endforeach()
endfunction()

# gyro_deblur_add_view(LAYER [HEADERS...]): the folder that stands for a layer on include paths: links to its own folder
# and to its public headers.
function(gyro_deblur_add_view layer)
  set(view ${PROJECT_BINARY_DIR}/layers/${layer})
  file(REMOVE_RECURSE ${view})
  file(MAKE_DIRECTORY ${view}/gyro_deblur)
  file(CREATE_LINK ${PROJECT_SOURCE_DIR}/src/${layer} ${view}/${layer} SYMBOLIC)
  foreach(header IN LISTS ARGN)
    if(NOT EXISTS ${PROJECT_SOURCE_DIR}/include/gyro_deblur/${header})
      message(FATAL_ERROR "layer ${layer}: there is no include/gyro_deblur/${header}")
    endif()
    file(CREATE_LINK ${PROJECT_SOURCE_DIR}/include/gyro_deblur/${header} ${view}/gyro_deblur/${header} SYMBOLIC)
  endforeach()
endfunction()

# gyro_deblur_add_layer(LAYER SOURCES... [HEADERS...] [LIBRARIES...]): the next layer. SOURCES are relative to
# src/LAYER, HEADERS are its public ones, in include/gyro_deblur.
function(gyro_deblur_add_layer layer)
  cmake_parse_arguments(ARG "" "" "SOURCES;HEADERS;LIBRARIES" ${ARGN})
  gyro_deblur_add_view(${layer} ${ARG_HEADERS})
  set_property(GLOBAL APPEND PROPERTY GYRO_DEBLUR_LAYERS ${layer})
  list(TRANSFORM ARG_SOURCES PREPEND ${PROJECT_SOURCE_DIR}/src/${layer}/)
  add_library(gyro_deblur_${layer} OBJECT ${ARG_SOURCES})
  gyro_deblur_see_layers(gyro_deblur_${layer} PRIVATE)
  target_include_directories(gyro_deblur_${layer} SYSTEM PRIVATE ${OpenCV_INCLUDE_DIRS})
  target_link_libraries(gyro_deblur_${layer} PRIVATE Eigen3::Eigen ${ARG_LIBRARIES} gyro_deblur_warnings)
  if(GYRO_DEBLUR_FUZZERS AND NOT layer MATCHES "^(base|motion|config)$")
    # Numerics: what a fuzzer looks for is in what reads data, and counting branches makes them much slower.
    # All that fuzzer-no-link stands for; without it precompiled headers do not fit.
    target_compile_options(gyro_deblur_${layer} PRIVATE
      -fno-sanitize-coverage=inline-8bit-counters,indirect-calls,trace-cmp,pc-table,stack-depth)
  endif()
  get_property(layers GLOBAL PROPERTY GYRO_DEBLUR_LAYERS)
  list(GET layers 0 first_layer)
  if(layer STREQUAL first_layer)
    gyro_deblur_precompile(gyro_deblur_${layer} ${gyro_deblur_core_headers})
  else()
    gyro_deblur_use_precompiled(gyro_deblur_${layer} gyro_deblur_${first_layer})
  endif()
endfunction()

# gyro_deblur_show_view(TARGET LAYER): the include path of one view, for the target and those who link it.
function(gyro_deblur_show_view target layer)
  target_include_directories(${target} PUBLIC $<BUILD_INTERFACE:${PROJECT_BINARY_DIR}/layers/${layer}>)
endfunction()

# gyro_deblur_live_in(TARGET LAYER): a library around the core, which sees the whole core and its own files, as do those
# who link it.
function(gyro_deblur_live_in target layer)
  gyro_deblur_add_view(${layer})
  gyro_deblur_see_layers(${target} PUBLIC)
  gyro_deblur_show_view(${target} ${layer})
endfunction()

# gyro_deblur_compile_for_instruction_sets(LAYER STEM): compiles src/LAYER/STEM_impl.hpp once per instruction set. Which
# copy runs is decided at run time (base/instruction_sets.hpp). GCC 12 warns about its own AVX-512 header (GCC bug
# 105593).
function(gyro_deblur_compile_for_instruction_sets layer stem)
  set(sets baseline)
  set(baseline_bytes 16)
  set(baseline_options "")
  if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
    list(APPEND sets avx2 avx512)
    set(avx2_bytes 32)
    set(avx2_options -mavx2 -mfma)
    set(avx512_bytes 64)
    set(avx512_options -mavx512f -mavx512bw -mavx512vl -mavx512dq -mavx512vnni -mavx512vbmi -mavx2 -mfma
      -mprefer-vector-width=512 -Wno-maybe-uninitialized -Wno-uninitialized)
  elseif(CMAKE_SYSTEM_NAME STREQUAL "Linux" AND CMAKE_SYSTEM_PROCESSOR STREQUAL "aarch64" AND CMAKE_SIZEOF_VOID_P EQUAL 8)
    list(APPEND sets dotprod)
    set(dotprod_bytes 16)
    set(dotprod_options -march=armv8.2-a+dotprod)
  endif()
  foreach(set ${sets})
    set(vector_bytes ${${set}_bytes})
    set(source ${CMAKE_CURRENT_BINARY_DIR}/simd/${layer}/${stem}_${set}.cpp)
    configure_file(${PROJECT_SOURCE_DIR}/cmake/simd_kernels.cpp.in ${source} @ONLY)
    target_sources(gyro_deblur_${layer} PRIVATE ${source})
    set_source_files_properties(${source} PROPERTIES SKIP_PRECOMPILE_HEADERS ON COMPILE_OPTIONS "${${set}_options}")
  endforeach()
endfunction()
