#include "../../core/nr_node.h"
#include "board.h"

int main(void)
{
    static struct nr_torque_app app;
    const struct nr_board *board = board_start();
    nr_torque_start(&app, board);
    for (;;) {
        board_idle(board, nr_torque_poll(&app, board));
    }
}
