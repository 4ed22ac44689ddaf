/* Declarations that esp32s3/main.c uses, after the API reference of ESP-IDF 5; for the tests on the host. */
#ifndef STUB_ESP_LOG_H
#define STUB_ESP_LOG_H

#include <stdio.h>

#define ESP_LOGE(tag, ...) ((void)(tag), (void)fprintf(stderr, __VA_ARGS__))

#endif
