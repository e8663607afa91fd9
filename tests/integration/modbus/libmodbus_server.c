/* A Modbus/TCP server on libmodbus, which the bridge's authors did not write.
 *
 *     libmodbus_server PORT
 *
 * Coils 0..63: every third is set. Discrete inputs 0..63: every second. Holding registers 0..199 and input registers
 * 0..199: address * 7 and address * 11. Holding 100..107: 12.5f, 0x41480000, in the orders ABCD, CDAB, BADC and DCBA (not by
 * modbus_set_float_abcd and its like, which turn the bytes on little-endian machines before libmodbus 3.1.8). What is
 * written to holding 150 appears in input 150.
 */
#include <modbus/modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int main(int argc, char **argv)
{
    if (argc != 2)
        return 2;
    modbus_t *context = modbus_new_tcp("127.0.0.1", atoi(argv[1]));
    modbus_mapping_t *map = modbus_mapping_new(64, 64, 200, 200);
    if (context == NULL || map == NULL)
        return 1;
    for (int i = 0; i < 64; i++) {
        map->tab_bits[i] = i % 3 == 0;
        map->tab_input_bits[i] = i % 2 == 0;
    }
    for (int i = 0; i < 200; i++) {
        map->tab_registers[i] = i * 7;
        map->tab_input_registers[i] = i * 11;
    }
    static const uint16_t floats[8] = {0x4148, 0, 0, 0x4148, 0x4841, 0, 0, 0x4841};
    memcpy(&map->tab_registers[100], floats, sizeof floats);
    int listener = modbus_tcp_listen(context, 4);
    if (listener < 0)
        return 1;
    printf("ready\n");
    fflush(stdout);
    for (;;) {
        if (modbus_tcp_accept(context, &listener) < 0)
            return 1;
        for (;;) {
            uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
            int length = modbus_receive(context, query);
            if (length < 0)
                break;
            if (length > 0 && modbus_reply(context, query, length, map) < 0)
                break;
            map->tab_input_registers[150] = map->tab_registers[150];
        }
        modbus_close(context);
    }
}
