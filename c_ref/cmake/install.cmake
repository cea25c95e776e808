# What find_package(mcp_asdf) and pkg-config find. Nothing in it names the prefix, so the tree may be moved, unless
# folders are given as absolute paths.
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)

set(package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/mcp_asdf)
# A t-table includes mcp_asdf_rom.h.
install(
    FILES src/mcp_asdf.h src/mcp_asdf_image.h src/mcp_asdf_frame.h src/mcp_asdf_small.h src/mcp_asdf_rom.h
    DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
install(TARGETS mcp_asdf EXPORT mcp_asdf INCLUDES DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
install(EXPORT mcp_asdf NAMESPACE mcp_asdf:: FILE mcp_asdf-config.cmake DESTINATION ${package_dir})

# Below 1.0 the minor number tells incompatible versions apart, from 1.0 on the major one.
set(compatibility SameMajorVersion)
if(PROJECT_VERSION_MAJOR EQUAL 0)
    set(compatibility SameMinorVersion)
endif()
write_basic_package_version_file(mcp_asdf-config-version.cmake COMPATIBILITY ${compatibility})
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/mcp_asdf-config-version.cmake DESTINATION ${package_dir})

set(pkgconfig_dir ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
if(IS_ABSOLUTE ${pkgconfig_dir})
    set(prefix ${CMAKE_INSTALL_PREFIX})
else()
    file(RELATIVE_PATH up_to_prefix /${pkgconfig_dir} /)
    set(prefix \${pcfiledir}/${up_to_prefix})
endif()
set(includedir "\${prefix}")
cmake_path(APPEND includedir ${CMAKE_INSTALL_INCLUDEDIR}) # which replaces it, if it is absolute
set(libdir "\${prefix}")
cmake_path(APPEND libdir ${CMAKE_INSTALL_LIBDIR})
configure_file(cmake/mcp_asdf.pc.in mcp_asdf.pc @ONLY)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/mcp_asdf.pc DESTINATION ${pkgconfig_dir})
