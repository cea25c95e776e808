# What the Cortex-M files share: GCC without a C library. They set cpu, the board's uart and QEMU's machine.
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR ${cpu})
set(CMAKE_C_COMPILER arm-none-eabi-gcc)
set(CMAKE_C_FLAGS_INIT "-mcpu=${cpu} -mthumb -mfloat-abi=soft -ffreestanding")
set(CMAKE_EXE_LINKER_FLAGS_INIT -nostdlib)
set(CMAKE_C_STANDARD_LIBRARIES_INIT -lgcc)
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)
set(MCP_ASDF_PORT cortex_m/start.c cortex_m/${uart} memory.c)
set(MCP_ASDF_LINKER_SCRIPT cortex_m/cortex_m.ld)
set(CMAKE_CROSSCOMPILING_EMULATOR
    qemu-system-arm -M ${machine} -display none -serial stdio -semihosting-config enable=on,target=native -kernel)
