# AVR, run under simavr: the ATmega328P of the Kilobot and the Arduino Uno, or another chip named by MCP_ASDF_AVR.
if(NOT MCP_ASDF_AVR)
    set(MCP_ASDF_AVR atmega328p)
    set(CMAKE_EXE_LINKER_FLAGS_INIT -Wl,--defsym=__TEXT_REGION_LENGTH__=32K) # the linker's default is 128 KB
endif()
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR avr)
set(CMAKE_C_COMPILER avr-gcc)
set(CMAKE_C_FLAGS_INIT -mmcu=${MCP_ASDF_AVR})
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)
set(CMAKE_TRY_COMPILE_PLATFORM_VARIABLES MCP_ASDF_AVR)
set(MCP_ASDF_PORT avr/atmega.c)
set(CMAKE_CROSSCOMPILING_EMULATOR simavr -m ${MCP_ASDF_AVR} -f 16000000)
