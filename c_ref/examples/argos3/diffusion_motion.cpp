#include "diffusion_motion.h"

#include <argos3/core/utility/math/vector2.h>

using namespace argos;

namespace
{
/* Obstacles nearly ahead that are this faint do not disturb. */
const Real FAINT = 0.1;
const CRadians AHEAD = ToRadians(CDegrees(5.0));

/* Deviations from the heading up to which a robot drives straight, and from which it turns on the spot. */
const CRadians STRAIGHT_BELOW = ToRadians(CDegrees(10.0));
const CRadians HARD_ABOVE = ToRadians(CDegrees(90.0));
/* A turn on the spot goes on until the deviation is this small, so that a robot does not waver. */
const CRadians HARD_UNTIL = ToRadians(CDegrees(70.0));

/* Return the direction in which the robot should go, seen from its front. */
CRadians ChooseHeading(const CCI_KheperaIVProximitySensor::TReadings &proximity)
{
    CVector2 obstacle;
    for (const auto &reading : proximity) {
        obstacle += CVector2(reading.Value, reading.Angle);
    }
    if (Abs(obstacle.Angle()) < AHEAD && obstacle.Length() < FAINT) {
        return CRadians::ZERO;
    }
    return (-obstacle).Angle();
}
} // namespace

void DiffusionMotion::Restart(Real max_speed)
{
    max_speed_ = max_speed;
    turn_ = Turn::None;
}

DiffusionMotion::Turn DiffusionMotion::ChooseTurn(const CRadians &deviation) const
{
    const CRadians hard_above = turn_ == Turn::Hard ? HARD_UNTIL : HARD_ABOVE;
    if (deviation > hard_above) {
        return Turn::Hard;
    }
    return deviation > STRAIGHT_BELOW ? Turn::Soft : Turn::None;
}

WheelSpeeds DiffusionMotion::ChooseSpeeds(const CCI_KheperaIVProximitySensor::TReadings &proximity)
{
    const CRadians heading = ChooseHeading(proximity);
    const CRadians deviation = Abs(heading);
    turn_ = ChooseTurn(deviation);

    Real inner_speed = max_speed_;
    if (turn_ == Turn::Soft) {
        /* The wider the turn, the slower the inner wheel. */
        inner_speed = max_speed_ * ((HARD_ABOVE - deviation) / HARD_ABOVE);
    } else if (turn_ == Turn::Hard) {
        inner_speed = -max_speed_;
    }
    /* Angles are counted to the left. */
    const bool is_left_turn = heading > CRadians::ZERO;
    return is_left_turn ? WheelSpeeds{inner_speed, max_speed_} : WheelSpeeds{max_speed_, inner_speed};
}
