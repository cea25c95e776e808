/* The air around a robot with one of the radios of c_ref/examples: what it has sent, and how it receives.
 * Each stub of a radio has these. */
#ifndef AIR_H
#define AIR_H

#include <stddef.h>
#include <stdint.h>

/* The last message that the robot has broadcast. */
extern uint8_t air_sent_data[64];
extern size_t air_sent_length;

/* Let the robot receive a message of up to 60 bytes. */
void air_deliver(const uint8_t *data, int length);

#endif
