/* The floor that the robots observe, and what they make of it: a table of all estimates as time goes on, and
 * the swarm's errors at the end. */
#include "asdf_controller.h"

#include <argos3/core/simulator/entity/controllable_entity.h>
#include <argos3/core/simulator/loop_functions.h>
#include <argos3/core/simulator/simulator.h>
#include <argos3/core/simulator/space/space.h>
#include <argos3/core/utility/logging/argos_log.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <string>
#include <vector>

using namespace argos;

namespace
{
/* Return a number from 0 to less than 1 that is drawn anew for each tile and each seed. The bits of the three
 * are mixed one after the other, as in the generator SplitMix64: a seed that was only combined with the
 * column would give other seeds the same columns in another order. */
Real DrawOfTile(UInt64 seed, SInt64 column, SInt64 row)
{
    UInt64 mixed = 0;
    for (const UInt64 value : {seed, static_cast<UInt64>(column), static_cast<UInt64>(row)}) {
        mixed = (mixed ^ value) + 0x9E3779B97F4A7C15ULL;
        mixed = (mixed ^ (mixed >> 30)) * 0xBF58476D1CE4E5B9ULL;
        mixed = (mixed ^ (mixed >> 27)) * 0x94D049BB133111EBULL;
        mixed ^= mixed >> 31;
    }
    return static_cast<Real>(mixed >> 11) / 9007199254740992.0; /* 53 bits over 2^53 */
}

Real InformedEstimate(const mcp_asdf_t &firmware) { return mcp_asdf_x(&firmware) / 8388608.0; }

Real AssumedAccuracy(const mcp_asdf_t &firmware) { return mcp_asdf_b_hat(&firmware) / 4294967296.0; }
} // namespace

class AsdfLoopFunctions : public CLoopFunctions
{
  public:
    /* Read the parameters, which swarm.argos explains. Throws CARGoSException for a robot with another
     * controller, and if the table cannot be written. */
    void Init(TConfigurationNode &parameters) override
    {
        GetNodeAttribute(parameters, "fill_ratio", fill_ratio_);
        GetNodeAttribute(parameters, "tile", tile_);
        GetNodeAttribute(parameters, "results", results_path_);
        GetNodeAttribute(parameters, "results_period", results_period_);
        if (!(fill_ratio_ >= 0.0 && fill_ratio_ <= 1.0 && tile_ > 0.0 && results_period_ > 0)) {
            THROW_ARGOSEXCEPTION("fill_ratio is " << fill_ratio_ << ", tile " << tile_ << ", results_period "
                                                  << results_period_
                                                  << "; they must be 0 to 1, above 0 and above 0");
        }
        FindRobots();
        Reset();
    }

    void Reset() override
    {
        error_sum_ = 0.0;
        error_count_ = 0;
        results_.close();
        results_.open(results_path_, std::ios::trunc);
        results_.precision(9); /* more than an estimate of 24 bits needs */
        results_ << "tick,robot,x,x_hat,b_hat,accepted,refused,tests,updates\n";
        CheckResults();
    }

    void Destroy() override { results_.close(); }

    void PostStep() override
    {
        const UInt32 tick = GetSpace().GetSimulationClock();
        if (tick % results_period_ != 0) {
            return;
        }
        const bool is_second_half = tick > GetSimulator().GetMaxSimulationClock() / 2;
        for (const AsdfController *robot : robots_) {
            WriteRow(tick, *robot);
            if (is_second_half) {
                error_sum_ += ErrorOf(*robot);
                ++error_count_;
            }
        }
        CheckResults();
    }

    void PostExperiment() override
    {
        Real final_error = 0.0;
        Real accuracy_error = 0.0;
        for (const AsdfController *robot : robots_) {
            final_error += ErrorOf(*robot);
            accuracy_error += std::abs(AssumedAccuracy(robot->Firmware()) - robot->SensorAccuracy());
        }
        const Real robot_count = static_cast<Real>(robots_.size());
        LOG << "mean |x - f| in the second half " << error_sum_ / static_cast<Real>(error_count_)
            << ", at the end " << final_error / robot_count << "; mean |b_hat - b| at the end "
            << accuracy_error / robot_count << std::endl;
    }

    CColor GetFloorColor(const CVector2 &position) override
    {
        const SInt64 column = static_cast<SInt64>(std::floor(position.GetX() / tile_));
        const SInt64 row = static_cast<SInt64>(std::floor(position.GetY() / tile_));
        const bool is_black = DrawOfTile(GetSimulator().GetRandomSeed(), column, row) < fill_ratio_;
        return is_black ? CColor::BLACK : CColor::WHITE;
    }

  private:
    void FindRobots()
    {
        for (auto &id_and_entity : GetSpace().GetEntitiesByType("controller")) {
            auto *entity = any_cast<CControllableEntity *>(id_and_entity.second);
            const auto *robot = dynamic_cast<const AsdfController *>(&entity->GetController());
            if (robot == nullptr) {
                THROW_ARGOSEXCEPTION("robot " << id_and_entity.first << " has another controller than "
                                              << "asdf_controller");
            }
            robots_.push_back(robot);
        }
        /* ARGoS sorts by name, where kiv10 comes before kiv2. */
        std::sort(robots_.begin(), robots_.end(), [](const AsdfController *a, const AsdfController *b) {
            return mcp_asdf_id(&a->Firmware()) < mcp_asdf_id(&b->Firmware());
        });
    }

    void WriteRow(UInt32 tick, const AsdfController &robot)
    {
        const mcp_asdf_t &firmware = robot.Firmware();
        const mcp_asdf_counters_t counters = mcp_asdf_counters(&firmware);
        const Real x_hat = mcp_asdf_x_hat(&firmware) / 8388608.0;
        results_ << tick << ',' << robot.GetId() << ',' << InformedEstimate(firmware) << ',' << x_hat << ','
                 << AssumedAccuracy(firmware) << ',' << robot.AcceptedPackets() << ','
                 << robot.RefusedPackets() << ',' << counters.tests << ',' << counters.updates << '\n';
    }

    Real ErrorOf(const AsdfController &robot) const
    {
        return std::abs(InformedEstimate(robot.Firmware()) - fill_ratio_);
    }

    void CheckResults() const
    {
        if (!results_) {
            THROW_ARGOSEXCEPTION("cannot write " << results_path_ << "; give another file as results");
        }
    }

    Real fill_ratio_ = 0.0;
    Real tile_ = 0.0; /* side of a tile in metres */
    std::string results_path_;
    UInt32 results_period_ = 0;

    std::vector<const AsdfController *> robots_;
    std::ofstream results_;
    Real error_sum_ = 0.0;
    UInt64 error_count_ = 0;
};

REGISTER_LOOP_FUNCTIONS(AsdfLoopFunctions, "asdf_loop_functions")
