# Third-party libraries. Here, not in the folders that use them, because imported targets must be known wherever a static
# library is linked. svokit-config.cmake.in and the .pc.in files repeat what the installed libraries need.
find_package(Threads REQUIRED)
find_package(PkgConfig REQUIRED)

# libskel. FLANN is header-only but for its serialisation, which wants lz4. (Its pkg-config file drags in MPI and HDF5, which
# the headers do not need.)
find_path(FLANN_INCLUDE_DIR flann/flann.hpp REQUIRED)
pkg_check_modules(LZ4 REQUIRED IMPORTED_TARGET liblz4)

# formats. Headers alone: nlohmann-json and tinygltf (Debian's shared library is not used: the header is compiled in
# adapters/gltf_load.cpp).
find_package(ZLIB REQUIRED)
find_package(BZip2 REQUIRED)
find_package(PNG REQUIRED)
find_package(JPEG REQUIRED)
find_package(draco REQUIRED)
pkg_check_modules(ZSTD REQUIRED IMPORTED_TARGET libzstd)
pkg_check_modules(XXHASH REQUIRED IMPORTED_TARGET libxxhash)
pkg_check_modules(JANSSON REQUIRED IMPORTED_TARGET jansson)
find_path(TINYGLTF_INCLUDE_DIR tiny_gltf.h REQUIRED)
find_path(NLOHMANN_INCLUDE_DIR nlohmann/json.hpp REQUIRED)

# Optional: .vdb and .nvdb are written where these are there. OpenVDB's own FindOpenVDB is a module beside its other CMake files. Not in builds with sanitizers:
# its TBB is not instrumented.
option(SVO_WITH_OPENVDB "Write .vdb and .nvdb where libopenvdb and libnanovdb are found" ON)
if(SVO_WITH_OPENVDB)
  find_path(OPENVDB_INCLUDE_DIR openvdb/openvdb.h)
  find_path(NANOVDB_INCLUDE_DIR nanovdb/NanoVDB.h)
  find_library(OPENVDB_LIBRARY openvdb)
  find_library(TBB_LIBRARY tbb)
endif()

# Optional: svo-compare reads OpenEXR pictures (svo-render writes them by itself).
option(SVO_WITH_OPENEXR "Compare OpenEXR pictures where libopenexr is found" ON)
if(SVO_WITH_OPENEXR)
  find_package(OpenEXR 3 QUIET CONFIG)
endif()

# Optional: svo-skeleton --repair cgal and --tessellate openmesh. CGAL's Polygon_mesh_processing is GPL: a svo-skeleton with it is GPL as a whole (docs/licences.md).
option(SVO_WITH_CGAL "Offer CGAL's repair of polygon soups in svo-skeleton where CGAL is found (GPL)" ON)
option(SVO_WITH_OPENMESH "Offer OpenMesh's splitting of edges in svo-skeleton where OpenMesh is found" ON)
if(SVO_WITH_CGAL)
  find_package(CGAL QUIET)
endif()
if(SVO_WITH_OPENMESH)
  find_path(OPENMESH_INCLUDE_DIR OpenMesh/Core/Mesh/TriMesh_ArrayKernelT.hh)
  find_library(OPENMESH_LIBRARY OpenMeshCore)
endif()
