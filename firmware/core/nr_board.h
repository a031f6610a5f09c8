/* What the nodes' main loops need of a board. The STM32 board serves these with registers, the host board with whatever the
 * test or the bench hands in. No call waits. */
#ifndef NR_BOARD_H
#define NR_BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct nr_board {
    void *context;
    uint32_t (*time_us)(void *context);
    /* 12-bit conversion of an analogue input; Hall sensor i has sine on 2 i and cosine on 2 i + 1 */
    uint16_t (*adc)(void *context, uint32_t channel);
    /* newest conversion of the load cell, signed 24 bit; false when there is none */
    bool (*load_cell)(void *context, int32_t *counts);
    /* encoder counter; false when the encoder reports an error */
    bool (*encoder)(void *context, int32_t *counts);
    /* whether the encoder stands over its index mark */
    bool (*index)(void *context);
    /* whether the emergency stop is pressed, or its loop broken anywhere */
    bool (*emergency_stop)(void *context);
    /* motor duty, +-2^15; 0 switches the bridge off */
    void (*duty)(void *context, int32_t duty);
    /* safe-torque-off line: false takes the bridge's supply away */
    void (*supply)(void *context, bool on);
    void (*can_send)(void *context, uint32_t id, const uint8_t data[8]);
    bool (*can_receive)(void *context, uint32_t *id, uint8_t data[8], uint32_t *length);
    void (*uart_send)(void *context, const uint8_t *bytes, size_t length);
    /* the node's calibration page */
    const void *(*calibration)(void *context);
};

#endif
