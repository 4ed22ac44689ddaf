/* Declarations that esp32s3/main.c uses, after the API reference of ESP-IDF 5; for the tests on the host. */
#ifndef STUB_LWIP_SOCKETS_H
#define STUB_LWIP_SOCKETS_H

#include <stddef.h>
#include <stdint.h>

typedef uint32_t socklen_t;
typedef int ssize_t;
struct sockaddr {
    uint8_t sa_len, sa_family;
    char sa_data[14];
};
struct in_addr {
    uint32_t s_addr;
};
struct sockaddr_in {
    uint8_t sin_len, sin_family;
    uint16_t sin_port;
    struct in_addr sin_addr;
    char sin_zero[8];
};
#define AF_INET 2
#define SOCK_DGRAM 2
#define IPPROTO_UDP 17
#define MSG_DONTWAIT 0x08
#define INADDR_ANY 0u
#define htons(x) ((uint16_t)((uint16_t)((x) << 8) | (uint16_t)((x) >> 8)))
#define htonl(x) ((uint32_t)(x)) /* of INADDR_ANY alone */
#define socket lwip_socket
#define bind lwip_bind
#define recvfrom lwip_recvfrom
#define sendto lwip_sendto

int lwip_socket(int domain, int type, int protocol);
int lwip_bind(int s, const struct sockaddr *name, socklen_t size);
ssize_t lwip_recvfrom(int s, void *data, size_t room, int flags, struct sockaddr *from, socklen_t *size);
ssize_t lwip_sendto(int s, const void *data, size_t size, int flags, const struct sockaddr *to, socklen_t length);

#endif
