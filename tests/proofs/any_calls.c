/* Every call of the firmware, with any arguments, on any memory contents: what Frama-C's Eva runs. Pointers
 * are sound, and a table has the 130 words that may be read of it. */
#include "mcp_asdf_arithmetic.h"

/* leading_zeros() by its lemma, where Eva sees that it is 0 to 31 at most. */
static uint32_t known_zeros(uint32_t value)
{
    const uint32_t zeros = leading_zeros(value);
    /*@ admit value >= 32 ==> zeros <= 26; */
    return zeros;
}
#define leading_zeros known_zeros

#include "mcp_asdf.c"
#include "mcp_asdf_frame.c"
#include "mcp_asdf_image.c"
#include "mcp_asdf_small.c"

#ifdef __FRAMAC__
#include "__fc_builtin.h"
#else /* for compilers, which have no values between two bounds */
void Frama_C_make_unknown(char *first, unsigned long count);
int Frama_C_interval(int least, int most);
unsigned char Frama_C_unsigned_char_interval(unsigned char least, unsigned char most);
unsigned long Frama_C_unsigned_long_interval(unsigned long least, unsigned long most);
#endif

/* The byte of an image that is the id: the last one before the checksum. */
#define ID_IN_IMAGE 119
#define ID_IN_ROBUST_IMAGE 151
#define UNKNOWN(object) Frama_C_make_unknown((char *)&(object), sizeof(object))

static uint32_t table[130];
static mcp_asdf_config_t config;
static mcp_asdf_t robot;
static uint8_t image[MCP_ASDF_IMAGE_SIZE];
static mcp_asdf_frame_t frame;
static mcp_asdf_frame_format_t format;
static mcp_asdf_estimate_t estimate_message;
static mcp_asdf_heartbeat_t heartbeat;
static mcp_asdf_telemetry_t telemetry;
static mcp_asdf_command_t command;
static mcp_asdf_small_message_t small_message;
static uint8_t small_bytes[MCP_ASDF_SMALL_BYTES];

static uint32_t word(void) { return (uint32_t)Frama_C_unsigned_long_interval(0, UINT32_MAX); }
static uint8_t byte(void) { return Frama_C_unsigned_char_interval(0, 255); }

static void forget_all(void)
{
    UNKNOWN(table);
    UNKNOWN(image);
    UNKNOWN(robot);
    UNKNOWN(frame);
    UNKNOWN(format);
    UNKNOWN(estimate_message);
    UNKNOWN(heartbeat);
    UNKNOWN(telemetry);
    UNKNOWN(command);
    UNKNOWN(small_message);
    UNKNOWN(small_bytes);
    robot.config = &config;
    config.table = table;
    config.filter_period = word();
    config.memory = word();
    config.filter = byte();
}

/* Calls with an id are written twice, for a valid and for an invalid id. Otherwise Eva would mix both, and
 * forget that an invalid id is refused before it serves as an index. */

/* Restore the robot from the image, whose byte at `place` is the id: once for a valid id, and once for
 * an invalid id. */
static void restore_with_id_at(uint8_t place)
{
    if (image[place] <= MCP_ASDF_MAX_ID) {
        (void)mcp_asdf_restore(&robot, &config, image);
    } else {
        (void)mcp_asdf_restore(&robot, &config, image);
    }
}

/* With the robust filter an image is longer. The filters before and behind it are tried apart: Eva would take
 * both for a range with it in between. */
static void restore_any(void)
{
    switch (Frama_C_interval(0, 2)) {
    case 0:
        config.filter = MCP_ASDF_ROBUST;
        restore_with_id_at(ID_IN_ROBUST_IMAGE);
        break;
    case 1:
        config.filter = Frama_C_unsigned_char_interval(0, MCP_ASDF_ROBUST - 1);
        restore_with_id_at(ID_IN_IMAGE);
        break;
    default:
        config.filter = Frama_C_unsigned_char_interval(MCP_ASDF_ROBUST + 1, 255);
        restore_with_id_at(ID_IN_IMAGE);
    }
}

/* Call the functions that accept a table with any contents or no table, and both codecs. */
static void call_any(void)
{
    const uint16_t subject = (uint16_t)word();
    config.table = Frama_C_interval(0, 1) != 0 ? table : 0;
    switch (Frama_C_interval(0, 5)) {
    case 0:
        (void)mcp_asdf_init(&robot, &config, byte(), word());
        break;
    case 1:
        restore_any();
        break;
    case 2:
        (void)mcp_asdf_encode_estimate(&frame, &format, &estimate_message);
        (void)mcp_asdf_encode_heartbeat(&frame, byte(), &heartbeat);
        (void)mcp_asdf_encode_telemetry(&frame, &format, &telemetry);
        break;
    case 3:
        (void)mcp_asdf_encode_small(small_bytes, &small_message);
        mcp_asdf_decode_small(&small_message, small_bytes);
        break;
    case 4:
        (void)mcp_asdf_x_hat_to_code(word(), (uint32_t)Frama_C_interval(1, MCP_ASDF_X_HAT_BITS_MAX));
        (void)mcp_asdf_x_hat_from_code(word(), (uint32_t)Frama_C_interval(1, MCP_ASDF_X_HAT_BITS_MAX));
        (void)mcp_asdf_alpha_to_code(word(), (uint32_t)Frama_C_interval(1, MCP_ASDF_ALPHA_BITS_MAX));
        (void)mcp_asdf_alpha_from_code(word(), (uint32_t)Frama_C_interval(1, MCP_ASDF_ALPHA_BITS_MAX));
        break;
    default:
        (void)mcp_asdf_decode_estimate(&estimate_message, subject, &frame);
        (void)mcp_asdf_decode_command(&command, subject, &frame);
    }
}

/* Those that rely on an accepted table: its first word is right. */
static void call_robot(void)
{
    table[0] = TABLE_MAGIC + (uint32_t)Frama_C_interval(2, MCP_ASDF_MAX_ID);
    switch (Frama_C_interval(0, 5)) {
    case 0:
        (void)mcp_asdf_observe(&robot, (mcp_asdf_observation_t)byte());
        break;
    case 1:
        (void)mcp_asdf_receive(&robot, byte(), word(), word());
        break;
    case 2:
        (void)mcp_asdf_step(&robot, (mcp_asdf_observation_t)byte());
        break;
    case 3:
        (void)(mcp_asdf_x(&robot) + mcp_asdf_x_bar(&robot));
        break;
    case 4:
        if (robot.id <= MCP_ASDF_MAX_ID) {
            (void)mcp_asdf_invariants_hold(&robot);
        } else {
            (void)mcp_asdf_invariants_hold(&robot);
        }
        break;
    default:
        mcp_asdf_save(&robot, image);
    }
}

int main(void)
{
    forget_all();
    if (Frama_C_interval(0, 1) != 0) {
        call_any();
    } else {
        call_robot();
    }
    return 0;
}
