/* The controller of a Khepera IV that estimates the share of black floor with the MCP-ASDF firmware, and
 * calibrates its ground sensor meanwhile.
 *
 * Of a tick, the firmware sees what mcp_asdf.h asks for: an observation, the neighbours' estimates, and the
 * end of the round. Range-and-bearing readings are those of the tick before, so this swarm does what
 * `mcp-asdf simulate --topology dynamic --latency 1` simulates. */
#ifndef ASDF_CONTROLLER_H
#define ASDF_CONTROLLER_H

#include "diffusion_motion.h"
#include "mcp_asdf.h"
#include "robot_log.h"

#include <argos3/core/control_interface/ci_controller.h>
#include <argos3/core/utility/math/rng.h>
#include <argos3/plugins/robots/generic/control_interface/ci_differential_steering_actuator.h>
#include <argos3/plugins/robots/generic/control_interface/ci_range_and_bearing_actuator.h>
#include <argos3/plugins/robots/generic/control_interface/ci_range_and_bearing_sensor.h>
#include <argos3/plugins/robots/kheperaiv/control_interface/ci_kheperaiv_ground_sensor.h>
#include <argos3/plugins/robots/kheperaiv/control_interface/ci_kheperaiv_proximity_sensor.h>

#include <string>

class AsdfController : public argos::CCI_Controller
{
  public:
    /* Read the parameters, which swarm.argos explains, and start the firmware. Throws CARGoSException for a
     * value that the firmware cannot have. */
    void Init(argos::TConfigurationNode &parameters) override;
    void ControlStep() override;
    void Reset() override;
    void Destroy() override;

    /* The firmware's state, for the accessors of mcp_asdf.h. */
    const mcp_asdf_t &Firmware() const { return firmware_; }

    /* Probability that the ground sensor names the colour correctly, which the firmware does not know. */
    argos::Real SensorAccuracy() const { return sensor_accuracy_; }

    /* Packets that the firmware took, and those without an estimate, or with one that it refused. */
    argos::UInt32 AcceptedPackets() const { return accepted_packets_; }
    argos::UInt32 RefusedPackets() const { return refused_packets_; }

  private:
    void ReadParameters(argos::TConfigurationNode &parameters);
    void StartFirmware();
    void Observe();
    void Broadcast();
    void Receive();
    bool ReceivePacket(const argos::CByteArray &packet);

    argos::CCI_DifferentialSteeringActuator *wheels_ = nullptr;
    argos::CCI_RangeAndBearingActuator *transmitter_ = nullptr;
    argos::CCI_RangeAndBearingSensor *receiver_ = nullptr;
    argos::CCI_KheperaIVGroundSensor *ground_sensor_ = nullptr;
    argos::CCI_KheperaIVProximitySensor *proximity_sensor_ = nullptr;
    argos::CRandom::CRNG *random_ = nullptr;

    argos::Real sensor_accuracy_ = 0.95;
    argos::Real max_speed_ = 14.14;
    uint32_t initial_b_hat_ = 0; /* in units of 2^-32 */
    std::string log_folder_;

    mcp_asdf_config_t config_{};
    mcp_asdf_t firmware_{};
    uint8_t broadcast_count_ = 0;
    argos::UInt32 accepted_packets_ = 0;
    argos::UInt32 refused_packets_ = 0;
    DiffusionMotion motion_;
    RobotLog log_;
};

#endif
