/* The nodes' main loops: start once, then poll without end. Each poll serves what came and, once a millisecond, ticks. */
#ifndef NR_NODE_H
#define NR_NODE_H

#include "nr_board.h"
#include "nr_drive.h"
#include "nr_hall.h"
#include "nr_torque.h"

enum { NR_TICK_US = 1000 };

struct nr_torque_app {
    struct nr_torque_node node;
    uint32_t next_us;
};

struct nr_hall_app {
    struct nr_hall_node node;
    uint32_t next_us;
};

struct nr_drive_app {
    struct nr_drive_node node;
    uint32_t next_us;
};

void nr_torque_start(struct nr_torque_app *app, const struct nr_board *board);
void nr_hall_start(struct nr_hall_app *app, const struct nr_board *board);
void nr_drive_start(struct nr_drive_app *app, const struct nr_board *board, const struct nr_drive_config *config);

/* True when this poll ticked. */
bool nr_torque_poll(struct nr_torque_app *app, const struct nr_board *board);
bool nr_hall_poll(struct nr_hall_app *app, const struct nr_board *board);
bool nr_drive_poll(struct nr_drive_app *app, const struct nr_board *board);

#endif
