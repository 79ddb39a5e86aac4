/* While a process is young, what it sends to one port is lost on the way. */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <dlfcn.h>
#include <netinet/in.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <time.h>

static double now_s(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static int is_lost(const struct sockaddr_in *to) {
    static double begun_s;
    if (begun_s == 0.0)
        begun_s = now_s();
    return to != NULL && to->sin_family == AF_INET && ntohs(to->sin_port) == atoi(getenv("LOST_PORT")) &&
           now_s() - begun_s < atof(getenv("LOST_S"));
}

ssize_t sendmsg(int socket, const struct msghdr *message, int flags) {
    static ssize_t (*real)(int, const struct msghdr *, int);
    if (real == NULL)
        real = (ssize_t(*)(int, const struct msghdr *, int))dlsym(RTLD_NEXT, "sendmsg");
    if (!is_lost(message->msg_name))
        return real(socket, message, flags);
    size_t bytes = 0;
    for (size_t i = 0; i < message->msg_iovlen; i++)
        bytes += message->msg_iov[i].iov_len;
    return (ssize_t)bytes;
}
