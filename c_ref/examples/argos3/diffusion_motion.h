/* How the robots move: straight on until something is near, then away from it. Nothing here is random; what
 * spreads the robots over the floor is that they meet each other and the walls. */
#ifndef DIFFUSION_MOTION_H
#define DIFFUSION_MOTION_H

#include <argos3/core/utility/math/angles.h>
#include <argos3/plugins/robots/kheperaiv/control_interface/ci_kheperaiv_proximity_sensor.h>

/* Speeds of the two wheels in cm/s. */
struct WheelSpeeds {
    argos::Real left;
    argos::Real right;
};

class DiffusionMotion
{
  public:
    /* Forget what the robot was doing, and drive at this speed in cm/s from now on. */
    void Restart(argos::Real max_speed);

    /* Return the wheel speeds for the next tick. A turn that has begun is carried on, so call this once a
     * tick. */
    WheelSpeeds ChooseSpeeds(const argos::CCI_KheperaIVProximitySensor::TReadings &proximity);

  private:
    enum class Turn { None, Soft, Hard };

    Turn ChooseTurn(const argos::CRadians &deviation) const;

    argos::Real max_speed_ = 0.0;
    Turn turn_ = Turn::None;
};

#endif
