#include "../../core/nr_node.h"
#include "board.h"

int main(void)
{
    static struct nr_drive_app app;
    const struct nr_board *board = board_start();
    nr_drive_start(&app, board, &nr_drive_defaults);
    for (;;) {
        board_idle(board, nr_drive_poll(&app, board));
    }
}
