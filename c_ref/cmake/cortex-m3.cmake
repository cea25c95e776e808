# Cortex-M3: Arm's MPS2 board with AN385, run under QEMU.
set(cpu cortex-m3)
set(machine mps2-an385)
set(uart mps2.c)
include(${CMAKE_CURRENT_LIST_DIR}/arm-none-eabi.cmake)
