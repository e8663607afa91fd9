/* A `make` that gets the processor each half second only, beside many other programs: preloaded, in place of `wait`.

   The kernel hands out an ended child before it delivers a signal, so what has come of both meanwhile is seen in this order. */

#include <signal.h>
#include <sys/wait.h>
#include <time.h>

pid_t wait(int *status)
{
    const struct timespec away = {0, 500 * 1000 * 1000};
    sigset_t interrupt, before;
    sigemptyset(&interrupt);
    sigaddset(&interrupt, SIGINT);
    for (;;) {
        sigprocmask(SIG_BLOCK, &interrupt, &before);
        nanosleep(&away, NULL);
        pid_t ended = waitpid(-1, status, WNOHANG);
        sigprocmask(SIG_SETMASK, &before, NULL);
        if (ended != 0)
            return ended;
    }
}
