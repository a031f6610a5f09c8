#include "nr_hall.h"

#include "nr_trig.h"

enum { MID_SCALE = 2048, UNIT_GAIN_Q14 = 16384, FRAME_TYPE_HALL = 1, LSB_PER_COUNT = 256 };

void nr_hall_init(struct nr_hall_node *node, const void *page)
{
    *node = (struct nr_hall_node){0};
    uint32_t serial; /* nobody asks for it on this line */
    node->calibrated = nr_page_read(page, NR_MAGIC_HALL, node->calibration, sizeof node->calibration, &serial);
    if (!node->calibrated) {
        for (int i = 0; i < NR_HALL_SENSORS; i++) {
            node->calibration[i] = (struct nr_hall_calibration){
                .sine_offset = MID_SCALE * LSB_PER_COUNT,
                .cosine_offset = MID_SCALE * LSB_PER_COUNT,
                .sine_gain_q14 = UNIT_GAIN_Q14,
                .cosine_gain_q14 = UNIT_GAIN_Q14,
            };
        }
    }
}

static int32_t corrected(uint16_t counts, int32_t offset, int32_t gain_q14)
{
    const int64_t centred = (int64_t)counts * LSB_PER_COUNT - offset;
    int64_t value = (centred * gain_q14) >> 14;
    const int64_t most = (int64_t)1 << 27;
    if (value > most) {
        value = most;
    } else if (value < -most) {
        value = -most;
    }
    return (int32_t)value;
}

int32_t nr_hall_angle_urad(const struct nr_hall_calibration *calibration, struct nr_hall_pair pair, uint16_t *field)
{
    const int32_t s = corrected(pair.sine, calibration->sine_offset, calibration->sine_gain_q14);
    const int32_t c = corrected(pair.cosine, calibration->cosine_offset, calibration->cosine_gain_q14);
    const struct nr_polar polar = nr_polar(s, c);
    const int32_t length = polar.length / (LSB_PER_COUNT / 16);
    *field = (uint16_t)(length > UINT16_MAX ? UINT16_MAX : length);
    const int32_t raw = polar.angle_urad;
    int64_t angle = (int64_t)raw - calibration->zero_urad;
    for (int k = 0; k < NR_HALL_HARMONICS; k++) {
        const int32_t argument = nr_wrapped_urad((int64_t)(k + 1) * raw + calibration->phase_urad[k]);
        angle -= ((int64_t)calibration->amplitude_urad[k] * nr_sin_q20(argument)) >> 20;
    }
    return nr_wrapped_urad(angle);
}

static size_t put(uint8_t *at, uint32_t value, size_t bytes)
{
    for (size_t i = 0; i < bytes; i++) {
        at[i] = (uint8_t)(value >> (8 * i));
    }
    return bytes;
}

size_t nr_hall_tick(struct nr_hall_node *node, uint32_t now_us, const struct nr_hall_pair pair[NR_HALL_SENSORS],
                    uint8_t frame[NR_COBS_MAX_FRAME])
{
    uint8_t content[8 + 6 * NR_HALL_SENSORS];
    uint16_t field[NR_HALL_SENSORS];
    size_t at = 0;
    at += put(content + at, FRAME_TYPE_HALL, 1);
    at += put(content + at, NR_HALL_SENSORS, 1);
    at += put(content + at, node->counter, 2);
    at += put(content + at, now_us, 4);
    for (int i = 0; i < NR_HALL_SENSORS; i++) {
        at += put(content + at, (uint32_t)nr_hall_angle_urad(&node->calibration[i], pair[i], &field[i]), 4);
    }
    for (int i = 0; i < NR_HALL_SENSORS; i++) {
        at += put(content + at, field[i], 2);
    }
    node->counter++;
    return nr_frame_encode(content, at, frame, NR_COBS_MAX_FRAME);
}
