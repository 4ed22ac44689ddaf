/* Declarations that esp32s3/main.c uses, after the API reference of ESP-IDF 5; for the tests on the host. */
#ifndef STUB_FREERTOS_FREERTOS_H
#define STUB_FREERTOS_FREERTOS_H

#include <stdint.h>

typedef uint32_t TickType_t;
typedef int BaseType_t;
typedef unsigned int UBaseType_t;
typedef struct QueueDefinition *QueueHandle_t;
#define configTICK_RATE_HZ 1000
#define pdMS_TO_TICKS(ms) ((TickType_t)((TickType_t)(ms) * (TickType_t)configTICK_RATE_HZ / 1000u))

#endif
