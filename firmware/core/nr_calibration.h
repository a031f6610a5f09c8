/* Calibration pages: what a node knows of its own sensors, in a page of flash of its own with a serial number and a CRC.
 * This is the one place where calibration is applied. A page that is blank or damaged leaves the neutral values: the
 * node then sends what its converters see. */
#ifndef NR_CALIBRATION_H
#define NR_CALIBRATION_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { NR_HALL_SENSORS = 4, NR_HALL_HARMONICS = 2 };

/* One sensor: two ADC counts to one angle.
 *   s = (sine - sine_offset) * sine_gain / 2^14,  c = (cosine - cosine_offset) * cosine_gain / 2^14
 *   raw = atan2(s, c);  angle = raw - zero - sum over k of amplitude_k * sin(k * raw + phase_k) */
struct nr_hall_calibration {
    int32_t sine_offset;
    int32_t cosine_offset;
    int32_t sine_gain_q14;
    int32_t cosine_gain_q14;
    int32_t zero_urad;
    int32_t amplitude_urad[NR_HALL_HARMONICS];
    int32_t phase_urad[NR_HALL_HARMONICS];
};

/* torque = (counts - offset) * gain / 2^24, in 1e-5 N.mm */
struct nr_torque_calibration {
    int32_t offset_counts;
    int32_t gain_q24;
};

/* Encoder counts of one turn of the needle, negative when the encoder counts backwards, and the duty that a velocity
 * needs (as in struct nr_drive_config). */
struct nr_drive_calibration {
    int32_t counts_per_turn;
    int32_t duty_per_velocity;
};

struct nr_page_header {
    uint32_t magic;
    uint32_t serial;
    uint32_t date; /* 20261121 */
    uint16_t length; /* of the content behind the header */
    uint16_t crc;    /* CRC-16 of the content */
};

enum { NR_MAGIC_HALL = 0x314C4148, NR_MAGIC_TORQUE = 0x31515254, NR_MAGIC_DRIVE = 0x31565244 };

/* Copies the content of `page` to `content`, and its serial number, when magic, length and CRC are right. */
bool nr_page_read(const void *page, uint32_t magic, void *content, size_t length, uint32_t *serial);

#endif
