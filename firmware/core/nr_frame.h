/* Frames on the wire: COBS with CRC-16 on the serial line, a CRC-8 in every CAN frame. */
#ifndef NR_FRAME_H
#define NR_FRAME_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { NR_COBS_MAX_CONTENT = 64, NR_COBS_MAX_FRAME = NR_COBS_MAX_CONTENT + 2 + 2 };

/* CRC-16/CCITT, polynomial 0x1021, initial value 0xFFFF, not reflected: Python's binascii.crc_hqx(data, 0xFFFF). */
uint16_t nr_crc16(const uint8_t *data, size_t length);

/* CRC-8 SAE J1850 (polynomial 0x1D, initial and final XOR 0xFF) over the frame id, low byte first, and
 * data bytes 0 to 6: the rule stated in config/needle_rig.dbc. */
uint8_t nr_can_checksum(uint32_t id, const uint8_t data[8]);
bool nr_can_valid(uint32_t id, const uint8_t *data, size_t length);

/* Content + CRC-16 (little-endian), COBS-stuffed, closed by 0x00. Gives the bytes written, 0 when `content` is
 * longer than NR_COBS_MAX_CONTENT or `room` is too small. */
size_t nr_frame_encode(const uint8_t *content, size_t length, uint8_t *out, size_t room);

/* The reverse, of the bytes before the 0x00. Gives the length of the content, 0 when the frame is damaged. */
size_t nr_frame_decode(const uint8_t *frame, size_t length, uint8_t *out, size_t room);

#endif
