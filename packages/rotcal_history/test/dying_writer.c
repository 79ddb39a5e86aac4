/* Lets a process die, or its disk or network fail, at a chosen call that others would notice. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/types.h>
#include <unistd.h>

static int left = -1, error = 0, sockets = 0;

/* From now on the call number `at` fails with `number`, and all later ones; 0: the process dies. */
void arm(int at, int number, int network) {
    left = at;
    error = number;
    sockets = network;
}

/* Whether the call came that was to fail. */
int fired(void) { return left == 0; }

static int is_ours(int fd) {
    char link[64], path[512];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0)
        return 0;
    path[length] = 0;
    return strstr(path, sockets ? "socket:" : "history.db") != NULL;
}

static int fails(int fd) {
    if (left < 0 || !is_ours(fd))
        return 0;
    if (left > 0 && --left > 0)
        return 0;
    if (error == 0)
        kill(getpid(), SIGKILL);
    if (sockets)
        shutdown(fd, SHUT_RDWR); /* a lost network gives no answer either */
    errno = error;
    return 1;
}

#define REAL(name) ((__typeof__(name) *)dlsym(RTLD_NEXT, #name))

ssize_t pwrite64(int fd, const void *data, size_t n, off64_t at) {
    return fails(fd) ? -1 : REAL(pwrite64)(fd, data, n, at);
}
ssize_t pwrite(int fd, const void *data, size_t n, off_t at) {
    return fails(fd) ? -1 : REAL(pwrite)(fd, data, n, at);
}
ssize_t write(int fd, const void *data, size_t n) {
    return fails(fd) ? -1 : REAL(write)(fd, data, n);
}
int fsync(int fd) { return fails(fd) ? -1 : REAL(fsync)(fd); }
int fdatasync(int fd) { return fails(fd) ? -1 : REAL(fdatasync)(fd); }
int ftruncate64(int fd, off64_t size) { return fails(fd) ? -1 : REAL(ftruncate64)(fd, size); }
int ftruncate(int fd, off_t size) { return fails(fd) ? -1 : REAL(ftruncate)(fd, size); }
ssize_t send(int fd, const void *data, size_t n, int flags) {
    return fails(fd) ? -1 : REAL(send)(fd, data, n, flags);
}
