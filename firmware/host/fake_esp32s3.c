/* ESP-IDF for one test: servos that stand at 524 counts, an INA226 at 7.4 V, datagrams from standard input, four ticks.
 *
 * Standard input: for each datagram a letter (its sender), its size in one byte, its bytes. Standard output: `u SENDER HEX` for each
 * datagram that leaves, `s - HEX` for each frame to the servos that asks nothing.
 */
#include <stdio.h>
#include <string.h>

#include "board.h"
#include "driver/i2c_master.h"
#include "driver/uart.h"
#include "esp_netif.h"
#include "esp_task_wdt.h"
#include "esp_timer.h"
#include "esp_wifi.h"
#include "lwip/sockets.h"
#include "nvs_flash.h"

void app_main(void);

static int64_t now = 1000000;
static int ticks = 0;
static uint8_t line[LX_MAX_BYTES];
static size_t waiting = 0, taken = 0;
esp_event_base_t const WIFI_EVENT = "WIFI_EVENT";

static void show(char what, char who, const uint8_t *data, size_t size) {
    printf("%c %c ", what, who);
    for (size_t i = 0; i < size; i++) printf("%02x", data[i]);
    printf("\n");
}

int64_t esp_timer_get_time(void) { return ++now; }

int uart_write_bytes(uart_port_t port, const void *data, size_t size) {
    lx_frame frame;
    (void)port;
    waiting = taken = 0;
    if (lx_decode(data, size, &frame) && frame.count == 0) {
        frame.reply = true;
        frame.count = 1;
        frame.value[0] = frame.code == LX_POS_READ ? 524 : 30;
        waiting = lx_encode(&frame, line);
    } else {
        show('s', '-', data, size);
    }
    return (int)size;
}

int uart_read_bytes(uart_port_t port, void *data, uint32_t size, TickType_t wait) {
    (void)port;
    if (taken == waiting) now += (int64_t)wait * 1000;
    size_t got = size < waiting - taken ? size : waiting - taken;
    memcpy(data, line + taken, got);
    taken += got;
    return (int)got;
}

esp_err_t uart_get_buffered_data_len(uart_port_t port, size_t *size) {
    (void)port;
    *size = waiting - taken;
    return ESP_OK;
}

ssize_t lwip_recvfrom(int s, void *data, size_t room, int flags, struct sockaddr *from, socklen_t *size) {
    struct sockaddr_in who;
    int letter = getchar(), bytes;
    (void)s, (void)flags;
    if (letter == EOF || (bytes = getchar()) == EOF) return -1;
    memset(&who, 0, sizeof who);
    who.sin_addr.s_addr = (uint32_t)letter;
    memcpy(from, &who, sizeof who);
    *size = sizeof who;
    return (ssize_t)fread(data, 1, (size_t)bytes < room ? (size_t)bytes : room, stdin);
}

ssize_t lwip_sendto(int s, const void *data, size_t size, int flags, const struct sockaddr *to, socklen_t length) {
    struct sockaddr_in who;
    (void)s, (void)flags;
    memcpy(&who, to, length);
    show('u', (char)who.sin_addr.s_addr, data, size);
    return (ssize_t)size;
}

esp_err_t i2c_master_transmit(i2c_master_dev_handle_t device, const uint8_t *data, size_t size, int timeout_ms) {
    (void)device, (void)data, (void)timeout_ms;
    return size == 3 ? ESP_OK : ESP_FAIL;
}

esp_err_t i2c_master_transmit_receive(i2c_master_dev_handle_t device, const uint8_t *data, size_t size, uint8_t *answer, size_t room,
                                      int timeout_ms) {
    (void)device, (void)data, (void)timeout_ms;
    if (size != 1 || room != 2) return ESP_FAIL;
    answer[0] = 0x17; /* 5920 counts of 1.25 mV */
    answer[1] = 0x20;
    return ESP_OK;
}

BaseType_t xTaskCreatePinnedToCore(TaskFunction_t task, const char *name, uint32_t stack, void *at, UBaseType_t priority,
                                   TaskHandle_t *made, BaseType_t core) {
    (void)name, (void)stack, (void)priority, (void)made, (void)core;
    task(at);
    return 1;
}

void vTaskDelayUntil(TickType_t *woken, TickType_t wait) {
    *woken += wait;
    if (++ticks == 4) exit(0);
}

TickType_t xTaskGetTickCount(void) { return 0; }
esp_err_t uart_driver_install(uart_port_t p, int r, int t, int q, QueueHandle_t *m, int f) {
    (void)p, (void)r, (void)t, (void)q, (void)m, (void)f;
    return ESP_OK;
}
esp_err_t uart_param_config(uart_port_t p, const uart_config_t *c) { (void)p; return c->baud_rate == 115200 ? ESP_OK : ESP_FAIL; }
esp_err_t uart_set_pin(uart_port_t p, int t, int r, int s, int c) { (void)p, (void)t, (void)r, (void)s, (void)c; return ESP_OK; }
esp_err_t uart_set_mode(uart_port_t p, uart_mode_t m) { (void)p, (void)m; return ESP_OK; }
esp_err_t uart_set_rx_timeout(uart_port_t p, const uint8_t s) { (void)p, (void)s; return ESP_OK; }
esp_err_t uart_wait_tx_done(uart_port_t p, TickType_t t) { (void)p, (void)t; return ESP_OK; }
esp_err_t i2c_new_master_bus(const i2c_master_bus_config_t *c, i2c_master_bus_handle_t *m) { (void)c; *m = NULL; return ESP_OK; }
esp_err_t i2c_master_bus_add_device(i2c_master_bus_handle_t b, const i2c_device_config_t *c, i2c_master_dev_handle_t *m) {
    (void)b;
    *m = NULL;
    return c->device_address == 0x40 ? ESP_OK : ESP_FAIL;
}
esp_err_t esp_task_wdt_add(TaskHandle_t t) { (void)t; return ESP_OK; }
esp_err_t esp_task_wdt_reset(void) { return ESP_OK; }
esp_err_t nvs_flash_init(void) { return ESP_OK; }
esp_err_t esp_netif_init(void) { return ESP_OK; }
esp_netif_t *esp_netif_create_default_wifi_sta(void) { return NULL; }
esp_err_t esp_event_loop_create_default(void) { return ESP_OK; }
esp_err_t esp_event_handler_register(esp_event_base_t b, int32_t i, esp_event_handler_t h, void *a) {
    (void)i;
    h(a, b, WIFI_EVENT_STA_START, NULL);
    return ESP_OK;
}
esp_err_t esp_wifi_init(const wifi_init_config_t *c) { (void)c; return ESP_OK; }
esp_err_t esp_wifi_set_mode(wifi_mode_t m) { (void)m; return ESP_OK; }
esp_err_t esp_wifi_set_config(wifi_interface_t i, wifi_config_t *c) {
    (void)i;
    return memcmp(c->sta.ssid, "tank", 5) == 0 && memcmp(c->sta.password, "password", 9) == 0 ? ESP_OK : ESP_FAIL;
}
esp_err_t esp_wifi_start(void) { return ESP_OK; }
esp_err_t esp_wifi_connect(void) { return ESP_OK; }
esp_err_t esp_wifi_set_ps(wifi_ps_type_t t) { return t == WIFI_PS_NONE ? ESP_OK : ESP_FAIL; }
int lwip_socket(int d, int t, int p) { (void)d, (void)t, (void)p; return 3; }
int lwip_bind(int s, const struct sockaddr *n, socklen_t z) { (void)s, (void)n, (void)z; return 0; }

int main(void) {
    app_main();
    return 1; /* the board's program never ends */
}
