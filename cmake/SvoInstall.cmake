# `cmake --install`: tools, libraries, headers, a CMake package (find_package(svokit)) and pkg-config files.
include(CMakePackageConfigHelpers)

# svo_install(target prefix [internal header]...): the library, and its public headers, which are those whose names begin
# with the prefix, without the internal ones.
function(svo_install target prefix)
  target_include_directories(${target} PUBLIC $<BUILD_INTERFACE:${CMAKE_CURRENT_SOURCE_DIR}>
                                              $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}/svokit>)
  file(GLOB headers CONFIGURE_DEPENDS ${prefix}*.h)
  list(TRANSFORM ARGN PREPEND ${CMAKE_CURRENT_SOURCE_DIR}/ OUTPUT_VARIABLE internal)
  list(REMOVE_ITEM headers ${internal} "")
  install(TARGETS ${target} EXPORT svokit-targets ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
  install(FILES ${headers} DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/svokit)
endfunction()

set(package_folder ${CMAKE_INSTALL_LIBDIR}/cmake/svokit)
install(EXPORT svokit-targets NAMESPACE svokit:: DESTINATION ${package_folder})
configure_package_config_file(${CMAKE_CURRENT_LIST_DIR}/svokit-config.cmake.in ${PROJECT_BINARY_DIR}/svokit-config.cmake
  INSTALL_DESTINATION ${package_folder})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/svokit-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/svokit-config.cmake ${PROJECT_BINARY_DIR}/svokit-config-version.cmake DESTINATION ${package_folder})

# The pkg-config files find their prefix from where they lie, so that an installation can be moved.
file(RELATIVE_PATH pc_prefix /prefix/${CMAKE_INSTALL_LIBDIR}/pkgconfig /prefix)
foreach(name svo svoskel svoformats)
  configure_file(${CMAKE_CURRENT_LIST_DIR}/${name}.pc.in ${PROJECT_BINARY_DIR}/${name}.pc @ONLY)
  install(FILES ${PROJECT_BINARY_DIR}/${name}.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
endforeach()
