#include "nr_frame.h"

uint16_t nr_crc16(const uint8_t *data, size_t length)
{
    uint16_t crc = 0xFFFFu;
    for (size_t i = 0; i < length; i++) {
        crc = (uint16_t)(crc ^ (uint16_t)((uint16_t)data[i] << 8));
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc & 0x8000u) ? (uint16_t)((uint16_t)(crc << 1) ^ 0x1021u) : (uint16_t)(crc << 1);
        }
    }
    return crc;
}

static uint8_t crc8_byte(uint8_t crc, uint8_t byte)
{
    crc = (uint8_t)(crc ^ byte);
    for (int bit = 0; bit < 8; bit++) {
        crc = (crc & 0x80u) ? (uint8_t)((uint8_t)(crc << 1) ^ 0x1Du) : (uint8_t)(crc << 1);
    }
    return crc;
}

uint8_t nr_can_checksum(uint32_t id, const uint8_t data[8])
{
    uint8_t crc = 0xFFu;
    crc = crc8_byte(crc, (uint8_t)(id & 0xFFu));
    crc = crc8_byte(crc, (uint8_t)((id >> 8) & 0xFFu));
    for (int i = 0; i < 7; i++) {
        crc = crc8_byte(crc, data[i]);
    }
    return (uint8_t)(crc ^ 0xFFu);
}

bool nr_can_valid(uint32_t id, const uint8_t *data, size_t length)
{
    return length == 8 && data[7] == nr_can_checksum(id, data);
}

size_t nr_frame_encode(const uint8_t *content, size_t length, uint8_t *out, size_t room)
{
    if (length > NR_COBS_MAX_CONTENT || room < length + 4) {
        return 0;
    }
    const uint16_t crc = nr_crc16(content, length);
    size_t code_at = 0;
    size_t at = 1;
    uint8_t code = 1;
    for (size_t i = 0; i < length + 2; i++) {
        uint8_t byte;
        if (i < length) {
            byte = content[i];
        } else {
            byte = (i == length) ? (uint8_t)(crc & 0xFFu) : (uint8_t)(crc >> 8);
        }
        if (byte == 0) {
            out[code_at] = code;
            code_at = at;
            at++;
            code = 1;
        } else {
            /* A block of 254 bytes needs no care: content is at most 66 bytes. */
            out[at] = byte;
            at++;
            code++;
        }
    }
    out[code_at] = code;
    out[at] = 0;
    return at + 1;
}

size_t nr_frame_decode(const uint8_t *frame, size_t length, uint8_t *out, size_t room)
{
    uint8_t raw[NR_COBS_MAX_CONTENT + 2];
    size_t filled = 0;
    size_t at = 0;
    while (at < length) {
        const uint8_t code = frame[at];
        at++;
        if (code == 0 || at + (size_t)(code - 1) > length) {
            return 0;
        }
        for (uint8_t i = 1; i < code; i++) {
            if (frame[at] == 0 || filled >= sizeof raw) {
                return 0;
            }
            raw[filled] = frame[at];
            filled++;
            at++;
        }
        if (code < 0xFFu && at < length) {
            if (filled >= sizeof raw) {
                return 0;
            }
            raw[filled] = 0;
            filled++;
        }
    }
    if (filled < 3) {
        return 0;
    }
    const size_t content = filled - 2;
    const uint16_t crc = (uint16_t)(raw[content] | (uint16_t)((uint16_t)raw[content + 1] << 8));
    if (content > room || crc != nr_crc16(raw, content)) {
        return 0;
    }
    for (size_t i = 0; i < content; i++) {
        out[i] = raw[i];
    }
    return content;
}
