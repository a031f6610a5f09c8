#include "../../core/nr_node.h"
#include "board.h"

int main(void)
{
    static struct nr_hall_app app;
    const struct nr_board *board = board_start();
    nr_hall_start(&app, board);
    for (;;) {
        board_idle(board, nr_hall_poll(&app, board));
    }
}
