# RV32IMC without an operating system.
set(arch rv32imc)
include(${CMAKE_CURRENT_LIST_DIR}/riscv64-unknown-elf.cmake)
