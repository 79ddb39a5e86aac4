/* While a process is young, it cannot tell who is at one port what it subscribes to: these packets
   are lost. It hears of all that is published there (DDSI-RTPS 2.5, 8.5.4). */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <dlfcn.h>
#include <netinet/in.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>

static double now_s(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static int is_to(const struct sockaddr_in *to, int port) {
    return to != NULL && to->sin_family == AF_INET && ntohs(to->sin_port) == port;
}

static int tells_subscriptions(const struct msghdr *message) {
    static const char writer[] = {0x00, 0x00, 0x04, (char)0xc2};
    for (size_t i = 0; i < message->msg_iovlen; i++)
        if (memmem(message->msg_iov[i].iov_base, message->msg_iov[i].iov_len, writer, 4))
            return 1;
    return 0;
}

static int is_lost(const struct msghdr *message) {
    static double begun_s;
    if (begun_s == 0.0)
        begun_s = now_s();
    return now_s() - begun_s < atof(getenv("LOST_S")) &&
           is_to(message->msg_name, atoi(getenv("LOST_PORT"))) && tells_subscriptions(message);
}

ssize_t sendmsg(int socket, const struct msghdr *message, int flags) {
    static ssize_t (*real)(int, const struct msghdr *, int);
    if (real == NULL)
        real = (ssize_t(*)(int, const struct msghdr *, int))dlsym(RTLD_NEXT, "sendmsg");
    if (!is_lost(message))
        return real(socket, message, flags);
    size_t bytes = 0;
    for (size_t i = 0; i < message->msg_iovlen; i++)
        bytes += message->msg_iov[i].iov_len;
    return (ssize_t)bytes;
}
