# Clang in place of a target's GCC, whose libgcc it keeps: -DCMAKE_TOOLCHAIN_FILE=clang.cmake -DMCP_ASDF_TARGET=cortex-m3
# for the toolchain file cortex-m3.cmake.
include(${CMAKE_CURRENT_LIST_DIR}/${MCP_ASDF_TARGET}.cmake)
list(APPEND CMAKE_TRY_COMPILE_PLATFORM_VARIABLES MCP_ASDF_TARGET)

set(gcc ${CMAKE_C_COMPILER})
separate_arguments(flags UNIX_COMMAND "${CMAKE_C_FLAGS_INIT}")
execute_process(COMMAND ${gcc} -dumpmachine OUTPUT_VARIABLE machine OUTPUT_STRIP_TRAILING_WHITESPACE)
if(NOT MCP_ASDF_CLANG_TARGET)
    set(MCP_ASDF_CLANG_TARGET ${machine})
endif()
set(CMAKE_C_COMPILER clang)
set(CMAKE_C_COMPILER_TARGET ${MCP_ASDF_CLANG_TARGET})

# LLVM's linker, where it knows the machine.
if(NOT CMAKE_SYSTEM_PROCESSOR STREQUAL s390x)
    string(APPEND CMAKE_EXE_LINKER_FLAGS_INIT " -fuse-ld=lld")
endif()
if(CMAKE_SYSTEM_NAME STREQUAL Generic)
    execute_process(COMMAND ${gcc} ${flags} -print-libgcc-file-name OUTPUT_VARIABLE libgcc OUTPUT_STRIP_TRAILING_WHITESPACE)
    set(CMAKE_C_STANDARD_LIBRARIES_INIT ${libgcc})
endif()
if(CMAKE_C_COMPILER_TARGET STREQUAL arm-none-eabi)
    # memcpy() by that name, also when the linker compiles
    string(APPEND CMAKE_C_FLAGS_INIT " -meabi gnu")
    string(APPEND CMAKE_EXE_LINKER_FLAGS_INIT " -Wl,-mllvm,-meabi=gnu")
endif()
