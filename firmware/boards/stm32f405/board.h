/* STM32F405 at 168 MHz with an 8 MHz crystal. */
#ifndef BOARD_H
#define BOARD_H

#include "../../core/nr_board.h"

const struct nr_board *board_start(void);

/* Between polls: moves serial bytes on; feeds the watchdog (20 ms) when the node has ticked. */
void board_idle(const struct nr_board *board, bool ticked);

#endif
