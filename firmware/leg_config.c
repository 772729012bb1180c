#include "leg_core.h"

#define LARGEST_UNITS (1 << 27) /* of angles and torques on CAN */

static bool within(int32_t value, int32_t low, int32_t high)
{
    return value >= low && value <= high;
}

static bool holds(const leg_config *c)
{
    return within(c->hold_torque_unm, 1, c->torque_limit_unm) && within(c->hold_ms, 1, 10000)
           && within(c->hold_stiffness_milli, 1, 1000000000) && within(c->hold_damping_milli, 0, 1000000000);
}

leg_refusal leg_examine(const leg_config *c, const leg_port *port, uint32_t boot_id)
{
    if (!port->send || !port->tick_us || !port->estop_open || !port->kick)
        return LEG_BAD_PORT;
    if (boot_id == 0)
        return LEG_BAD_BOOT_ID;
    if (!within(c->telemetry_hz, 1, 1000) || 1000000 % c->telemetry_hz)
        return LEG_BAD_TELEMETRY_HZ;
    if (c->gear_ratio_milli == 0 || c->gear_ratio_milli == UINT32_MAX)
        return LEG_BAD_GEAR_RATIO;
    if (!within(c->torque_limit_unm, 1, LARGEST_UNITS - 1))
        return LEG_BAD_TORQUE_LIMIT;
    if (!within(c->watchdog_limit_ms, LEG_WATCHDOG_MS_MIN, LEG_WATCHDOG_MS_MAX))
        return LEG_BAD_WATCHDOG;
    if (!within(c->current_limit_ua, 1, 1000000000))
        return LEG_BAD_CURRENT_LIMIT;
    if (!within(c->temperature_limit_cdegc, 1, 20000))
        return LEG_BAD_TEMPERATURE_LIMIT;
    if (!within(c->undervoltage_mv, 1, c->overvoltage_mv - 1) || c->overvoltage_mv == LEG_INVALID_MV)
        return LEG_BAD_VOLTAGES;
    if (!within(c->speed_limit_uradps, 1, 1000000000) || !within(c->speed_derate_uradps, 1, c->speed_limit_uradps))
        return LEG_BAD_SPEED_LIMIT;
    if (!within(c->position_min_urad, 1 - LARGEST_UNITS, LARGEST_UNITS - 1)
        || !within(c->position_max_urad, 1 - LARGEST_UNITS, LARGEST_UNITS - 1)
        || !within(c->position_derate_urad, 0, (c->position_max_urad - c->position_min_urad) / 2)
        || c->position_min_urad >= c->position_max_urad)
        return LEG_BAD_POSITION_LIMITS;
    if (c->reaction != LEG_LIMP && c->reaction != LEG_BRAKE && !(c->reaction == LEG_HOLD && holds(c)))
        return LEG_BAD_REACTION;
    return LEG_ACCEPTED;
}
