# Cortex-M4 without its floating-point unit: Arm's MPS2 board with AN386, run under QEMU.
set(cpu cortex-m4)
set(machine mps2-an386)
set(uart mps2.c)
include(${CMAKE_CURRENT_LIST_DIR}/arm-none-eabi.cmake)
