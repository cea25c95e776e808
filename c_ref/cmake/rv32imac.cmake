# RV32IMAC without an operating system.
set(arch rv32imac)
include(${CMAKE_CURRENT_LIST_DIR}/riscv64-unknown-elf.cmake)
