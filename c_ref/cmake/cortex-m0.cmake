# Cortex-M0: the micro:bit, run under QEMU.
set(cpu cortex-m0)
set(machine microbit)
set(uart nrf51.c)
include(${CMAKE_CURRENT_LIST_DIR}/arm-none-eabi.cmake)
