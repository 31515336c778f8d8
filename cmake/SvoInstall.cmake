# `cmake --install`: tools, libraries, headers, a CMake package (find_package(svokit)) and pkg-config files.
include(CMakePackageConfigHelpers)
install(EXPORT svokit-targets NAMESPACE svokit:: DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/svokit)
configure_package_config_file(${CMAKE_CURRENT_SOURCE_DIR}/cmake/svokit-config.cmake.in
  ${CMAKE_CURRENT_BINARY_DIR}/svokit-config.cmake INSTALL_DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/svokit)
write_basic_package_version_file(${CMAKE_CURRENT_BINARY_DIR}/svokit-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/svokit-config.cmake ${CMAKE_CURRENT_BINARY_DIR}/svokit-config-version.cmake
        DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/svokit)
foreach(name svo svoskel svoformats)
  configure_file(${CMAKE_CURRENT_SOURCE_DIR}/cmake/${name}.pc.in ${CMAKE_CURRENT_BINARY_DIR}/${name}.pc @ONLY)
  install(FILES ${CMAKE_CURRENT_BINARY_DIR}/${name}.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
endforeach()
