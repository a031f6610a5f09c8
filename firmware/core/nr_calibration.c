#include "nr_calibration.h"

#include "nr_frame.h"

#include <string.h>

bool nr_page_read(const void *page, uint32_t magic, void *content, size_t length, uint32_t *serial)
{
    struct nr_page_header header;
    memcpy(&header, page, sizeof header);
    const uint8_t *bytes = (const uint8_t *)page + sizeof header;
    if (header.magic != magic || header.length != length || header.crc != nr_crc16(bytes, length)) {
        return false;
    }
    memcpy(content, bytes, length);
    *serial = header.serial;
    return true;
}
